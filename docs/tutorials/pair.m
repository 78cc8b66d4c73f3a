% A pair of images, defocused to both sides, determines the amplitude of their defocus.
scene = strjoin({'[pupil]', 'aperture = "hexagonal"', 'rings = 1', 'samples = 120', ...
    '[image]', 'wavelength_nm = 2000', 'samples_per_lambda_over_d = 2', 'pixels = 128', 'crop_pixels = 128', ...
    'diversity_focus_waves_rms = 1.0', 'read_noise_e = 20', ...
    '[modes]', 'ncpa = "zernike"', 'ncpa_count = 14', 'exact_zernikes = []', ''}, newline);
pair = [scene, strjoin({'[[image.channel]]', 'name = "plus"', 'diversity_focus_waves_rms = 1.0', ...
    '[[image.channel]]', 'name = "minus"', 'diversity_focus_waves_rms = -1.0', ''}, newline)];

% In place of a camera: the defocus is 2 % larger than in the scene.
for name = {'plus', 'minus'}
    defocus = 1.02 - 2.04 * strcmp(name{1}, 'minus');
    model = cophase.Model(cophase.scene_set(scene, 'image.diversity_focus_waves_rms', defocus));
    segments = 1:model.segment_modes;
    truth_nm = 15 * cos(5 * (0:model.modes - 1)');
    truth_nm(segments) = 80 * sin(4 * (segments - 1));
    truth_nm(segments) = truth_nm(segments) - mean(truth_nm(segments));
    psf = model.psf(truth_nm);
    star_e = 300 ^ 2 * psf / max(psf(:));
    frames_e.(name{1}) = star_e + sqrt(star_e + 20 ^ 2) .* randn(size(star_e));
end

fitted = cophase.scene_set(pair, 'estimate.fit_optics', {'defocus'});
names = {'one image', 'pair', 'pair, defocus fitted'};
estimates = {cophase.Estimator(scene).estimate(frames_e.plus), ...
    cophase.Estimator(pair).estimate(frames_e), ...
    cophase.Estimator(fitted).estimate(frames_e)};
focus = find(strcmp(model.mode_names, 'noll-4'));
for k = 1:3
    e = estimates{k};
    errors_nm(k) = e.coefficients_nm(focus) - truth_nm(focus);
    fprintf('error of focus, %s: %.3f ± %.3f nm\n', names{k}, errors_nm(k), e.sigma_nm(focus));
    fprintf('   reduced χ² %.2f\n', e.info.reduced_chi2);
    cellfun(@(sentence) fprintf('   warning: %s\n', sentence), e.warnings);
end
assert(abs(errors_nm(1)) > 20 && abs(errors_nm(3)) < 2)
