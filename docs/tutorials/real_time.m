% Fits with a deadline, frame by frame, and their running estimate.
scene = strjoin({'[pupil]', 'aperture = "keck"', 'grid_m = 10.95', 'samples = 60', ...
    '[image]', 'wavelength_nm = 2168.6', 'samples_per_lambda_over_d = 2', 'pixels = 96', 'crop_pixels = 96', ...
    'diversity_focus_waves_rms = 0.7', 'read_noise_e = 10', ...
    '[estimate]', 'sampling = "native"', ''}, newline);
model = cophase.Model(scene);
session = cophase.Session(model, 'precision', 'f32', 'threads', 1);
sequence = cophase.Sequence(model, 50);

% In place of a camera: frames of a million electrons; the pistons are 40 nm RMS.
segments = 1:model.segment_modes;
truth_nm = zeros(model.modes, 1);
truth_nm(segments) = 57 * sin(4 * (segments - 1));
truth_nm(segments) = truth_nm(segments) - mean(truth_nm(segments));
star_e = 1e6 * model.psf(truth_nm);
expose = @() star_e + sqrt(star_e + 10 ^ 2) .* randn(size(star_e));
error_nm = @(found_nm) std(found_nm(segments) - truth_nm(segments), 1);

for k = 1:50
    [found_nm, report] = session.fit(expose(), 'deadline_s', 1.0);
    if strcmp(report.status, 'OK')
        sequence.push(session)
    end
    errors_nm(k) = error_nm(found_nm);
end

running = sequence.estimate();
fprintf('%d of %d frames used\n', running.info.used, running.info.images);
fprintf('phasing: %.2f ± %.2f nm\n', running.info.phasing_rms_nm, running.info.phasing_sigma_nm);
fprintf('NCPA: %.2f ± %.2f nm\n', running.info.ncpa_rms_nm, running.info.ncpa_sigma_nm);
fprintf('error of the pistons: one frame %.2f nm, running estimate %.2f nm\n', mean(errors_nm), ...
    error_nm(running.coefficients_nm));
assert(error_nm(running.coefficients_nm) < 0.5 * mean(errors_nm))

[found_nm, report] = session.fit(expose(), 'deadline_s', 1e-3);
fprintf('%s after %d evaluations\n', report.status, report.evaluations);
