% What comes with the MATLAB package, under Octave: its help and its examples; run by tests/c_api/main.rs, see there:
%
%   octave-cli package.m BINDINGS LIBRARY_DIRECTORY SCRATCH

1; % a script, not a function of this file's name

function help_reads_like_matlabs(name)
    text = get_help_text(name);
    title = strsplit(name, '.'){end};
    assert(strncmp(strtrim(text), [toupper(title) '  '], numel(title) + 2), '%s: %s', name, text);
    assert(~isempty(strfind(text, 'See also')), '%s: %s', name, text);
end

[bindings, libraries, scratch] = argv(){:};
addpath(bindings, fullfile(bindings, 'examples'), scratch);
build(libraries, scratch);

cellfun(@help_reads_like_matlabs, {'build', 'artificial_source', 'oomao_style', 'on_sky', 'cophase.Handle', 'cophase.Model', ...
    'cophase.Session', 'cophase.Sequence', 'cophase.Simulator', 'cophase.FullPhase', 'cophase.preset', 'cophase.devices', ...
    'cophase.version', ...
    'cophase.Model.fromArrays', 'cophase.Model.wavefront', 'cophase.Model.psf', 'cophase.Session.fit', ...
    'cophase.Session.calibrate', 'cophase.Session.covariance', 'cophase.Session.message', 'cophase.Session.deviceFailure', ...
    'cophase.Session.load', 'cophase.Session.evaluate', 'cophase.Sequence.push', 'cophase.Sequence.estimate', 'cophase.Sequence.covariance', ...
    'cophase.Sequence.imagesNeeded', 'cophase.Sequence.clear', 'cophase.Simulator.step', ...
    'cophase.FullPhase.estimate', 'cophase.FullPhase.corrections', 'cophase.FullPhase.imagesNeeded', ...
    'cophase.FullPhase.calibrate'});

assert(~isempty(regexp(cophase.version(), '^\d+\.\d+\.\d+')));

[c, truth_nm] = oomao_style();
% Error bars are 0.6 nm at most: six of them.
assert(max(abs(c - truth_nm)) < 4);

% The library's own reproduction of the figure leaves 0.1 nm of both, in this noise; the paper 4.4 and 7.2 nm.
residual_nm = artificial_source(1, scratch);
assert(size(residual_nm), [1 2]);
assert(all(residual_nm < 0.3));

% 57 and 76 nm are to be found. Six exposures leave 14 and 4 nm: about twice that is allowed.
residual_nm = on_sky(6, scratch);
assert(residual_nm < [25, 10]);
if ~isempty(available_graphics_toolkits())
    assert(isfile(fullfile(scratch, 'on_sky.png')));
    assert(isfile(fullfile(scratch, 'artificial_source_maps.png')));
    assert(isfile(fullfile(scratch, 'artificial_source_residuals.png')));
end
