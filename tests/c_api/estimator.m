% Estimators and their estimates through the MATLAB package, under Octave; run by tests/c_api/main.rs, see there:
%
%   octave-cli estimator.m SCENE.toml DUMP BINDINGS LIBRARY_DIRECTORY SCRATCH
%
% The scene has a loop, and is given estimate.method = "full-phase": a MAP estimate. DUMP receives, as doubles in C
% order, as in the C test: frames, slopes, coefficients and their standard deviations, covariance, maps, error budget,
% corrections.

1; % a script, not a function of this file's name

source(fullfile(fileparts(mfilename('fullpath')), 'support.m'));

[scene, dump, bindings, libraries, scratch] = argv(){:};
addpath(bindings, scratch);
build(libraries, scratch);
without = fileread(scene);
scene = [without, sprintf('\n[estimate]\nmethod = "full-phase"\n')];

sky = cophase.Simulator(scene);
count = 4;
for k = 1:count
    if k == 1
        sky.step(300);
    else
        sky.step(60);
    end
    frames(:, :, k) = sky.image_e;
    slopes_mas(:, k) = sky.slopes_mas;
end
truth = {sky.phasing_nm, sky.ncpa_nm};
delete(sky);

% ---- refusals

must_fail('BAD_ARGUMENT', 'scene is', @() cophase.Estimator());
must_fail('BAD_SCENE', 'estimate.optimizer = "bfgs"', @() cophase.Estimator([scene, sprintf('optimizer = "bfgs"\n')]));
must_fail('BAD_VALUE', '''full'' or ''realtime'' is accepted', @() cophase.Estimator(scene, 'policy', 'quick'));
must_fail('BAD_VALUE', 'threads is 0', @() cophase.Estimator(scene, 'threads', 0));
must_fail('BAD_VALUE', 'threads is 1.5', @() cophase.Estimator(scene, 'threads', 1.5));
must_fail('BAD_VALUE', 'threads is -2', @() cophase.Estimator(scene, 'threads', -2));
missing = cophase.scene_set(without, 'mirror.actuator_file', 'none.txt');
must_fail('BAD_FILE', 'mirror.actuator_file', @() cophase.Estimator(missing));
f = cophase.Estimator(scene, 'policy', 'full', 'directory', '.');
must_fail('BAD_SHAPE', 'slopes were given for each image', @() f.estimate(frames, 'slopes_mas', slopes_mas(2:end, :)));
must_fail('BAD_SHAPE', 'slopes_mas is 1 x 3 x', @() f.estimate(frames, 'slopes_mas', slopes_mas(:, 2:end)));
must_fail('BAD_SHAPE', 'frames is 4 x 71 x 80', @() f.estimate(frames(2:end, :, :)));
must_fail('BAD_SHAPE', 'bad is 1 x 71 x 80', @() f.estimate(frames, 'mask', false(71, 80)));
must_fail('BAD_SHAPE', 'mask has', @() f.estimate(frames, 'mask', false(72, 80, 3)));
must_fail('BAD_VALUE', 'set estimate.telemetry of the scene', @() f.estimate(frames, 'slopes_mas', -slopes_mas));
must_fail('BAD_VALUE', 'slopes of 0 of 4 images', @() f.estimate(frames, 'slopes_mas', NaN * slopes_mas));
must_fail('BAD_VALUE', 'read_noise_e is -1', @() f.estimate(frames, 'read_noise_e', -1));
must_fail('BAD_ARGUMENT', 'is no option here', @() f.estimate(frames, 'slope', slopes_mas, 'nose', 1));
must_fail('BAD_ARGUMENT', 'frames is missing', @() cophase.Estimate(f));
must_fail('BAD_ARGUMENT', 'no such Estimator', @() cophase.Estimate(3, frames));
must_fail('BAD_IMAGE', '0 of 4 images', @() f.estimate(0 * frames));

% ---- raw values, of another class, with a bad pixel marked in three ways: the same bits

e = f.estimate(frames, 'slopes_mas', slopes_mas);
delete(f); % its estimates stay usable
f = cophase.Estimator(scene, 'threads', 1);
raw = f.estimate(frames / 2 + 8, 'slopes', slopes_mas, 'dark', 8 * ones(72, 80), 'gain', 2);
assert(raw.coefficients_nm, e.coefficients_nm);
% As modal estimates, which read masks in the same way, take less time.
delete(f);
f = cophase.Estimator([without, sprintf('\n[modes]\nncpa_count = 20\n')]);
mask = false(72, 80);
mask(31, 42:43) = true;
unknown = frames;
unknown(repmat(mask, [1 1 count])) = NaN;
masked = f.estimate(unknown);
assert(f.estimate(frames, 'mask', mask).coefficients_nm, masked.coefficients_nm);
known = f.estimate(frames, 'mask', repmat(mask, [1 1 count]));
assert(known.coefficients_nm, masked.coefficients_nm);
assert(~any(~cellfun(@isempty, strfind(known.warnings, 'not finite'))));
single = false(72, 80, count);
single(:, :, 1) = mask;
unknown = frames;
unknown(single) = NaN;
assert(f.estimate(frames, 'mask', single).coefficients_nm, f.estimate(unknown).coefficients_nm);
assert(~any(isnan(frames(:)))); % they are not changed
assert(any(~cellfun(@isempty, strfind(masked.warnings, 'not finite'))));
assert(numel(masked.warnings), masked.info.warnings);

% ---- results

assert({e.method, e.policy, e.info.ao_knowledge, e.info.precision}, {'map', 'full', 'telemetry', 'f32'});
assert(e.info.images, count);
assert(e.info.used, sum([e.images.is_used]));
assert(e.info.has_settled && e.info.iterations >= 2);
assert({e.images.status}, repmat({'OK'}, 1, count));
assert(~isempty(strfind(e.images(1).message, 'reduced')));
assert(numel(e.mode_names), numel(e.coefficients_nm));
assert(e.info.segment_modes, 7);
assert(isempty(e.image_coefficients_nm));
assert(e.sigma_nm, sqrt(diag(e.covariance_nm2)), -1e-12);
assert(class(e.phasing_nm), 'double');
assert(~isempty(strfind(e.error_budget{1, 1}, 'noise')));
budget_nm = cell2mat(e.error_budget(:, 2:3));
assert(sqrt(sum(budget_nm .^ 2, 1)), [e.info.phasing_sigma_nm, e.info.ncpa_sigma_nm], -1e-9);
assert(~isempty(strfind(e.report(), 'phasing')) && ~isempty(strfind(e.scene, '[image]')));
% Four exposures leave 8 of 60 and 7 of 50 nm: less than half.
found = {e.phasing_nm, e.ncpa_nm};
for k = 1:2
    inside = ~isnan(truth{k});
    assert(std(found{k}(inside) - truth{k}(inside)) < 0.5 * std(truth{k}(inside)));
end

% ---- files, and a correction with a limit and without

path = [dump '.fits'];
e.write(path);
assert(fileread(path)(1:6), 'SIMPLE');
unlink(path);
must_fail('BAD_FILE', '/nowhere', @() e.write('/nowhere/estimate.fits'));
must_fail('BAD_VALUE', 'limit_nm is -1', @() e.correct(-1));
c = e.correct(5, path);
assert(fileread(path)(1:6), 'SIMPLE');
unlink(path);
assert(max(abs(c.pistons_nm)), 5);
assert(c.limited > 0 && c.corrected_modes > 0);
assert(sum(cellfun(@isempty, c.ncpa_held)), c.corrected_modes);
assert(numel(c.segments_held), numel(c.pistons_nm) + numel(c.tilts_nm));
assert(c.ncpa_drop_nm2 > 0);
assert(isempty(c.warnings));
c = e.correct();
assert(size(c.actuators_m), [2, numel(c.actuators_nm)]);

% MATLAB's memory has columns: transposed, it has the rows that the other languages dump.
out = fopen(dump, 'w');
for values = {permute(frames, [2 1 3]), slopes_mas, e.coefficients_nm, e.sigma_nm, e.covariance_nm2', e.phasing_nm', ...
        e.ncpa_nm', e.phasing_sigma_nm', e.ncpa_sigma_nm', budget_nm', c.pistons_nm, c.actuators_nm, c.actuators_m, ...
        c.slopes_mas}
    fwrite(out, values{1}, 'double');
end
fclose(out);
delete(e);
must_fail('BAD_ARGUMENT', 'deleted', @() e.report());

% ---- a modal estimate of the realtime policy, of an image of 2e6 electrons

table = [dump '.txt'];
out = fopen(table, 'w');
fprintf(out, '%d %d 0.5\n', [0:6; 100:106]);
fclose(out);
tiny = fileread(fullfile(fileparts(mfilename('fullpath')), 'tiny.toml'));
tiny = [tiny sprintf('\n[mirror]\nactuators_across = 7\npitch_m = 0.8\n[commands]\nsegment_file = "%s"\n', table)];
m = cophase.Model(tiny);
e = cophase.Estimator(tiny, 'policy', 'realtime').estimate(round(2e6 * m.psf(30 * cos(1:m.modes)) + 30));
assert({e.method, e.policy, e.info.ao_knowledge}, {'modal', 'realtime', ''});
assert(e.image_coefficients_nm, e.coefficients_nm, 1e-9);
c = e.correct();
unlink(table);
assert({c.segment_commands.name}, {'100', '101', '102', '103', '104', '105', '106'});
assert([c.segment_commands.add]', 0.5 * c.pistons_nm);
assert(isempty(c.actuator_commands) && numel(c.actuators_nm) > 20 && isempty(c.slopes_mas));
must_fail('BAD_FILE', 'segment_file', @() e.correct());
