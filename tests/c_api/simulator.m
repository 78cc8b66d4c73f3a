% The simulator through the MATLAB package, under Octave; run by tests/c_api/main.rs, see there:
%
%   octave-cli simulator.m SCENE.toml FRAMES DUMP BINDINGS LIBRARY_DIRECTORY SCRATCH

1; % a script, not a function of this file's name

source(fullfile(fileparts(mfilename('fullpath')), 'support.m'));

[scene, frames, dump, bindings, libraries, scratch] = argv(){:};
frames = str2double(frames);
addpath(bindings, scratch);
% A gateway that was built in the source tree is on the path, too.
if exist('cophase_mex', 'file') == 0
    must_fail('BAD_FILE', ['run build in ' bindings], @() cophase.version());
    must_fail('BAD_FILE', 'run build in', @() cophase.Simulator('keck-onsky'));
    must_fail('BAD_FILE', 'run build in', @() cophase.Model.from_arrays(ones(8), []));
end
build(libraries, scratch);

must_fail('BAD_SCENE', 'apertur', @() cophase.Simulator(sprintf('[pupil]\napertur = 3\n')));
must_fail('BAD_SCENE', 'keck-onsky', @() cophase.preset('keck-onsy'));
must_fail('BAD_ARGUMENT', 'scene is', @() cophase.Simulator(3));
must_fail('BAD_ARGUMENT', 'no command', @() cophase_mex('simulator.stride', 1));
must_fail('BAD_ARGUMENT', 'deleted', @() cophase_mex('simulator.info', 99));
assert(~isempty(strfind(cophase.preset('keck-onsky'), '[wavefront_sensor]')));
artificial = cophase.preset('keck-artificial');
changed = cophase.scene_set(artificial, 'image.peak_snr', 37.5, 'modes.exact_zernikes', [4, 18], ...
    'image.photon_noise', false, 'estimate.device', 'cpu', 'estimate.fit_optics', {'plate-scale', 'rotation'});
for part = {'= 37.5 ', '[4, 18]', '= false', '= "cpu"', '["plate-scale", "rotation"]', 'lambda/D below'}
    assert(~isempty(strfind([changed ' '], part{1})), 'the scene has no %s', part{1});
end
assert(isempty(strfind(cophase.scene_set(changed, 'modes.exact_zernikes', []), 'exact_zernikes')));
assert(cophase.scene_set(artificial), artificial);
assert(cophase.scene_set('keck-artificial', 'image.pixels', 128), cophase.scene_set(artificial, 'image.pixels', 128));
assert(cophase.scene_set(scene), fileread(scene));
for take = {@cophase.Estimator, @cophase.Model, @cophase.Simulator, @cophase.scene_set}
    must_fail('BAD_FILE', 'no.toml: there is no such file of a scene', @() take{1}(fullfile(scratch, 'no.toml')));
    must_fail('BAD_SCENE', 'did you mean ''keck-onsky''?', @() take{1}('keck-onsy'));
end
% The files that a scene names are beside it.
mine = fullfile(scratch, 'mine.toml');
out = fopen(mine, 'w');
fputs(out, cophase.scene_set(scene, 'mirror.actuator_file', 'none.txt'));
fclose(out);
must_fail('BAD_FILE', fullfile(scratch, 'none.txt'), @() cophase.Estimator(mine));
must_fail('BAD_SCENE', 'image.flux_e', @() cophase.scene_set('keck-onsky', 'image.photon_noise', false, ...
    'image.read_noise_e', 0));
assert(~isempty(strfind(cophase.scene_set(artificial, 'pupil.grid_m', 11 + 1 / 3), '11.333333333333334')));
must_fail('BAD_SCENE', 'image.pixels = 7', @() cophase.scene_set(artificial, 'image.pixels', 7));
must_fail('BAD_SCENE', 'did you mean', @() cophase.scene_set(artificial, 'image.pixel', 32));
must_fail('BAD_ARGUMENT', 'no value', @() cophase.scene_set(artificial, 'image.pixels'));
must_fail('BAD_ARGUMENT', 'class double and size [2 2]', @() cophase.scene_set(artificial, 'image.pixels', eye(2)));
must_fail('BAD_ARGUMENT', 'scene is', @() cophase.scene_set(3, 'image.pixels', 32));

s = cophase.Simulator(fileread(scene), '.');
assert(mislocked('cophase_mex'));
must_fail('BAD_VALUE', 'step first', @() s.image_e);
assert(isempty(s.warnings));
coarse = cophase.Simulator(cophase.scene_set(scene, 'wavefront_sensor.samples_per_lenslet', 6));
assert(numel(coarse.warnings), 1);
assert(strncmp(coarse.warnings{1}, '60 samples across the pupil', 27));
delete(coarse);
must_fail('BAD_VALUE', 'frames is', @() s.step(-1));
must_fail('BAD_VALUE', 'frames is', @() s.step(1.5));
must_fail('BAD_VALUE', 'frames is', @() s.step(NaN));
s.step();
s.step(frames - 1);
assert(s.info.frames, frames);
assert(s.info.frame_s, 1 / 1054);
assert(isnan(s.info.divergence_s));
assert(s.info.residual_rms_nm > 0);
assert(class(s.image_e), 'double');
assert(size(s.image_e), [s.info.rows, s.info.cols]);

% MATLAB's memory has columns: transposed, it has the rows that the other languages dump.
out = fopen(dump, 'w');
for values = {s.slopes_mas, s.commands_nm, s.residual_nm.', s.image_e.', s.phasing_nm.', s.ncpa_nm.'}
    fwrite(out, values{1}, 'single');
end
fclose(out);

% Two at once, and each goes when it is deleted; a number that is stale finds nothing.
t = cophase.Simulator(scene);
delete(s);
must_fail('BAD_ARGUMENT', 'deleted', @() s.info);
assert(t.info.frames, 0);
delete(t);
delete(t);
assert(~mislocked('cophase_mex'));
