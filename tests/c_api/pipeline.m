% The whole pipeline through the MATLAB package, under Octave, on a file of raw doubles, printed as by pipeline.c:
%
%   octave-cli pipeline.m SCENE.toml FRAMES.raw COUNT ROWS COLS [SLOPES.raw SLOPES] [CHANNEL,CHANNEL]
%
% The library is that of the directory COPHASE_LIBRARIES, or else of target/release; the gateway is built in the
% directory COPHASE_SCRATCH, or else in a new one.

1; % a script, not a function of this file's name

function values = doubles_of(path)
    file = fopen(path, 'r');
    values = fread(file, Inf, 'double');
    fclose(file);
end

root = fileparts(fileparts(fileparts(mfilename('fullpath'))));
libraries = getenv('COPHASE_LIBRARIES');
if isempty(libraries)
    libraries = fullfile(root, 'target', 'release');
end
scratch = getenv('COPHASE_SCRATCH');
if isempty(scratch)
    scratch = tempname();
    mkdir(scratch);
end
addpath(fullfile(root, 'bindings', 'matlab'), scratch);
build(libraries, scratch);

arguments = argv();
extents = str2double(arguments(3:5));
% Rows in the file are columns in memory.
frames = permute(reshape(doubles_of(arguments{2}), extents(3), extents(2), []), [2 1 3]);
options = {};
if numel(arguments) > 6
    slopes_mas = reshape(doubles_of(arguments{6}), str2double(arguments{7}), extents(1), []);
    options = {'slopes_mas', slopes_mas};
end
if any(numel(arguments) == [6 8])
    names = strsplit(arguments{end}, ',')(:);
    frames = cell2struct(mat2cell(frames, extents(2), extents(3), repmat(extents(1), 1, numel(names)))(:), names);
    if numel(arguments) == 8
        each = mat2cell(slopes_mas, rows(slopes_mas), extents(1), ones(1, numel(names)));
        options = {'slopes_mas', cell2struct(each(:), names)};
    end
end
e = cophase.Estimator(fileread(arguments{1})).estimate(frames, options{:});
for k = 1:numel(e.mode_names)
    printf('coefficient %s %s %s\n', e.mode_names{k}, num2hex(e.coefficients_nm(k)), num2hex(e.sigma_nm(k)));
end
for k = 1:numel(e.images)
    printf('image %d %s %s %d %d\n', k - 1, e.images(k).status, num2hex(e.images(k).reduced_chi2), ...
        e.images(k).rejected_pixels, e.images(k).channel - 1);
end
cellfun(@(name) printf('channel %s\n', name), e.channels);
for k = 1:rows(e.integers)
    printf('integer %d %s %s\n', e.integers(k, 1), num2hex(e.integers(k, 2)), num2hex(e.integers(k, 3)));
end
for k = 1:numel(e.model_errors)
    error_k = e.model_errors(k);
    numbers = {error_k.value, error_k.sigma, error_k.tolerance, error_k.significance};
    printf('error %s %s %s %s %s\n', error_k.name, cellfun(@num2hex, numbers, 'UniformOutput', false){:});
end
w = e.without_staircases;
if ~isempty(w)
    printf('without phasing %s %s\n', num2hex(w.info.phasing_rms_nm), num2hex(w.info.phasing_sigma_nm));
    printf('without ncpa %s %s\n', num2hex(w.info.ncpa_rms_nm), num2hex(w.info.ncpa_sigma_nm));
    printf('without wavefront %s %s\n', num2hex(w.info.wavefront_rms_nm), num2hex(w.info.wavefront_sigma_nm));
    at = @(map) num2hex(map(floor(rows(map) / 2) + 1, floor(columns(map) / 4) + 1));
    printf('without %s %s %s %s\n', at(w.phasing_nm), at(w.ncpa_nm), at(w.phasing_sigma_nm), at(w.ncpa_sigma_nm));
end
cellfun(@(sentence) printf('warning %s\n', sentence), e.warnings);
printf('policy %s\ndevice %s\n', e.policy, e.device);
