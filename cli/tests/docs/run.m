% Runs blocks of a page one after the other; see interpreters.rs:
%
%   octave-cli run.m ROOT LIBRARY_DIRECTORY GATEWAY FILE...
%
% Presets are small scenes of the same kind. The gateway is built where GATEWAY has none.

1; % a script, not a function of this file's name

function text = small_preset(root, name)
    if strcmp(name, 'keck-onsky')
        text = [fileread(fullfile(root, 'tests/c_api/sky.toml')), sprintf('\n[estimate]\nmethod = "full-phase"\n')];
    else
        text = fileread(fullfile(root, 'cli/tests/docs/presets', [name '.toml']));
    end
end

% An image of a star with two segments out of phase; the noise has the variance of photons and read noise.
function frame_e = image_e(model)
    truth_nm = zeros(model.modes, 1);
    truth_nm([3 21]) = [60 -60];
    star_e = 1e7 * model.psf(truth_nm);
    frame_e = star_e + sqrt(star_e + 60 ^ 2) .* randn(size(star_e));
end

% Four exposures behind adaptive optics, and the slopes of each.
function [frames, slopes_mas] = exposures(scene)
    simulator = cophase.Simulator(scene);
    for k = 1:4
        simulator.step(60 + 240 * (k == 1));
        frames(:, :, k) = simulator.image_e;
        slopes_mas(:, k) = simulator.slopes_mas;
    end
end

arguments_ = argv();
[root_, libraries_, gateway_] = arguments_{1:3};
addpath(fullfile(root_, 'bindings/matlab'), gateway_);
if ~exist(fullfile(gateway_, 'cophase_mex.mex'), 'file')
    build(libraries_, gateway_);
end
randn('state', 1);
for file_ = arguments_(4:end)'
    fprintf(stderr, '-- %s\n', file_{1});
    % A function of a package cannot be replaced: its name in the text is.
    eval(regexprep(fileread(file_{1}), 'cophase\.preset\(', 'small_preset(root_, '));
end
