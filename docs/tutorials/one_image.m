% One image: segment pistons and NCPA, with error bars, from one defocused image of a point source.
scene = cophase.scene_set(cophase.preset('keck-artificial'), ...
    'image.samples_per_lambda_over_d', 2, 'image.pixels', 128, 'image.crop_pixels', 128);
model = cophase.Model(scene);

% In place of a camera: pistons of 64 nm RMS, and 73 nm RMS of NCPA in the Zernike modes 4 (focus) to 18.
segments = 1:model.segment_modes;
truth_nm = zeros(model.modes, 1);
truth_nm(segments) = 90 * sin(4 * (segments - 1));
for noll = 4:18
    truth_nm(strcmp(model.mode_names, sprintf('noll-%d', noll))) = 27 * cos(5 * noll);
end
read_noise_e = 60;
psf = model.psf(truth_nm);
star_e = 200 ^ 2 * psf / max(psf(:));
frame_e = star_e + sqrt(star_e + read_noise_e ^ 2) .* randn(size(star_e));

e = cophase.Estimator(scene).estimate(frame_e, 'read_noise_e', read_noise_e);
disp(e.report())
fprintf('phasing: %.2f ± %.2f nm\n', e.info.phasing_rms_nm, e.info.phasing_sigma_nm);
fprintf('NCPA: %.2f ± %.2f nm\n', e.info.ncpa_rms_nm, e.info.ncpa_sigma_nm);

% The piston of each segment against the truth; an image does not show the mean of all pistons.
true_nm = truth_nm(segments) - mean(truth_nm(segments));
normalised = (e.coefficients_nm(segments) - true_nm) ./ e.sigma_nm(segments);
fprintf('scatter of the normalised residuals: %.2f\n', std(normalised));
assert(std(normalised) > 0.5 && std(normalised) < 2)

% imagesc(e.phasing_nm), axis image, axis xy, colorbar draws the map.
