% Full-phase estimates through the MATLAB package, under Octave; run by tests/c_api/main.rs, see there:
%
%   octave-cli full_phase.m SCENE.toml DUMP BINDINGS LIBRARY_DIRECTORY SCRATCH

1; % a script, not a function of this file's name

source(fullfile(fileparts(mfilename('fullpath')), 'support.m'));

[scene, dump, bindings, libraries, scratch] = argv(){:};
addpath(bindings, scratch);
build(libraries, scratch);
scene = fileread(scene);

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

% ---- what is refused

must_fail('BAD_ARGUMENT', 'scene_text', @() cophase.FullPhase());
must_fail('BAD_SCENE', 'estimate.optimizer = "bfgs"', ...
    @() cophase.FullPhase([scene, sprintf('\n[estimate]\noptimizer = "bfgs"\n')]));
f = cophase.FullPhase(scene(1:strfind(scene, '[wavefront_sensor]') - 1));
must_fail('BAD_SCENE', 'no [wavefront_sensor] and [control]', ...
    @() f.estimate(frames, 'Slopes_mas', slopes_mas, 'Knows', 'telemetry'));
delete(f);
f = cophase.FullPhase(scene, '.');
assert(f.FrameSize, [72 80]);
must_fail('BAD_SCENE', 'images come without slopes', @() f.estimate(frames, 'Knows', 'telemetry'));
must_fail('BAD_VALUE', 'Knows is ''everything''', @() f.estimate(frames, 'Knows', 'everything'));
must_fail('BAD_SHAPE', 'slopes were given for each image', @() f.estimate(frames, 'Slopes_mas', slopes_mas(2:end, :)));
must_fail('BAD_SHAPE', 'slopes_mas is 1 x 3 x', @() f.estimate(frames, 'Slopes_mas', slopes_mas(:, 2:end)));
must_fail('BAD_SHAPE', 'frames is 4 x 71 x 80', @() f.estimate(frames(2:end, :, :)));
must_fail('BAD_VALUE', 'is NaN mas', @() f.estimate(frames, 'Slopes_mas', NaN * slopes_mas));
must_fail('BAD_VALUE', 'Threads is -1', @() f.estimate(frames, 'Threads', -1));
must_fail('BAD_VALUE', 'read_noise_e is -1', @() f.estimate(frames, 'ReadNoise_e', -1));
must_fail('BAD_ARGUMENT', 'is no option here', @() f.estimate(frames, 'Slope', slopes_mas, 'Nose', 1));
must_fail('BAD_IMAGE', '0 of 4 images', @() f.estimate(0 * frames));
must_fail('BAD_VALUE', 'no estimate yet', @() f.corrections());
must_fail('BAD_VALUE', 'no estimate yet', @() f.imagesNeeded(1));

% ---- raw values, of another class: the same bits

e = f.estimate(frames, 'Slopes_mas', slopes_mas);
f.calibrate('Dark', 8 * ones(f.FrameSize), 'Gain_e', 2);
raw = f.estimate(double(frames) / 2 + 8, 'slopes', double(slopes_mas), 'Threads', 1);
assert(e.Coefficients_nm, raw.Coefficients_nm);

assert(e.Images, count);
assert(e.Used, sum([e.Reports.Used]));
assert(e.Settled && e.Passes >= 2);
assert(e.Knows, 'telemetry');
assert({e.Reports.Status}, repmat({'OK'}, 1, count));
assert(~isempty(strfind(e.Reports(1).Message, 'reduced')));
assert(numel(e.Names), numel(e.Coefficients_nm));
assert(e.SegmentModes, 7);
assert(e.Sigma_nm, sqrt(diag(e.Covariance_nm2)), -1e-12);
assert(class(e.Phasing_nm), 'single');
% Half of the truth is found by far: four exposures leave 8 of 60 and 7 of 50 nm.
found = {e.Phasing_nm, e.Ncpa_nm};
for k = 1:2
    glass = ~isnan(truth{k});
    assert(std(found{k}(glass) - truth{k}(glass)) < 0.5 * std(truth{k}(glass)));
end
assert(f.imagesNeeded(Inf), 0);
assert(f.imagesNeeded(0.1) > count);
must_fail('BAD_VALUE', 'ncpa_nm is 0', @() f.imagesNeeded(1, 0));

c = f.corrections(5);
assert(max(abs(c.Pistons_nm)), 5);
assert(c.Limited > 0 && c.CorrectedModes > 0);
c = f.corrections();

% MATLAB's memory has columns: transposed, it has the rows that the other languages dump. A covariance is its own
% transpose, but for rounding: the gateway hands it on as it lies.
out = fopen(dump, 'w');
fwrite(out, permute(double(frames), [2 1 3]), 'double');
for values = {slopes_mas, e.Coefficients_nm, e.Sigma_nm, e.Covariance_nm2, e.Phasing_nm.', e.Ncpa_nm.', ...
        e.PhasingSigmaMap_nm.', e.NcpaSigmaMap_nm.', c.Pistons_nm, c.Actuators_nm, c.Actuators_m, c.Slopes_mas}
    fwrite(out, double(values{1}), 'double');
end
fclose(out);

% What is not known of the loop is warned of.
f.calibrate();
blind = f.estimate(frames, 'Knows', 'spectrum');
assert(~isempty(strfind(blind.Warnings{end}, 'loop''s answer')));
delete(f);
must_fail('BAD_ARGUMENT', 'deleted', @() f.imagesNeeded(1));
