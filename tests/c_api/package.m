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

cellfun(@help_reads_like_matlabs, {'build', 'artificial_source', 'oomao_style', 'on_sky', 'cophase.Handle', ...
    'cophase.Estimator', 'cophase.Estimator.estimate', 'cophase.Estimate', 'cophase.Estimate.report', ...
    'cophase.Estimate.write', 'cophase.Estimate.correct', 'cophase.Model', 'cophase.Model.from_arrays', ...
    'cophase.Model.wavefront_nm', 'cophase.Model.psf', 'cophase.Session', 'cophase.Session.fit', ...
    'cophase.Model.channel', 'cophase.Session.calibrate', 'cophase.Session.refine', 'cophase.Session.message', ...
    'cophase.Session.warnings', 'cophase.Session.evaluate', 'cophase.Sequence', 'cophase.Sequence.push', ...
    'cophase.Sequence.estimate', 'cophase.Sequence.images_needed', 'cophase.Sequence.clear', 'cophase.Simulator', ...
    'cophase.Simulator.step', 'cophase.preset', 'cophase.scene_set', 'cophase.devices', 'cophase.version'});

assert(~isempty(regexp(cophase.version(), '^\d+\.\d+\.\d+')));

[c, truth_nm] = oomao_style();
% Error bars are 0.6 nm at most: six of them.
assert(max(abs(c - truth_nm)) < 4);

% The library's own reproduction of the figure leaves 0.1 nm of both, in this noise; the paper 4.4 and 7.2 nm.
residual_nm = artificial_source(1, scratch);
assert(size(residual_nm), [1 2]);
assert(all(residual_nm < 0.3));

% Of 57 and 76 nm six exposures leave 14 and 4 nm: about twice that is allowed.
residual_nm = on_sky(6, scratch);
assert(residual_nm < [25, 10]);
if ~isempty(available_graphics_toolkits())
    assert(isfile(fullfile(scratch, 'on_sky.png')));
    assert(isfile(fullfile(scratch, 'artificial_source_maps.png')));
    assert(isfile(fullfile(scratch, 'artificial_source_residuals.png')));
end
