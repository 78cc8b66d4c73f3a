function [c, truth_nm] = oomao_style()
    %OOMAO_STYLE  A pupil and a modes matrix in, coefficients out.
    %   [c, truth_nm] = oomao_style() builds a model from a pupil and a matrix with a mode in each column, as OOMAO's
    %   zernike and deformableMirror classes keep them, takes an image of known coefficients, and estimates them from
    %   it. With OOMAO the first lines would be
    %
    %       zern = zernike(4:11, 8, 'resolution', 64);
    %       pupil = zern.pupil; modes = zern.modes;
    %
    %   Example:
    %       [c, truth_nm] = oomao_style();
    %       bar([truth_nm, c])
    %
    %   See also cophase.Model.from_arrays, artificial_source.
    [pupil, modes] = zernikes(64);

    model = cophase.Model.from_arrays(pupil, modes, 'wavelength_nm', 2200, 'frame_shape', 128, ...
        'diversity_focus_waves_rms', 0.5);
    session = cophase.Session(model);

    randn('state', 1);
    truth_nm = 30 * randn(model.modes, 1);
    psf = model.psf(truth_nm);
    photons = 1e6 * psf;
    frame = zeros(model.frame_shape);
    middle = model.frame_shape(1) / 2 - model.pixels / 2 + (1:model.pixels);
    frame(middle, middle) = photons + sqrt(photons) .* randn(size(psf));

    [c, report] = session.fit(single(frame), 'read_noise_e', 1);
    [~, covariance_nm2] = session.refine();
    sigma_nm = sqrt(diag(covariance_nm2));
    fprintf('%s after %d evaluations\n', report.status, report.evaluations);
    for mode = 1:model.modes
        fprintf('%-8s %8.2f nm, estimated %8.2f +- %.2f nm\n', ...
            model.mode_names{mode}, truth_nm(mode), c(mode), sigma_nm(mode));
    end
end

function [pupil, modes] = zernikes(n)
    % Noll's 4 to 11 on a disc, unit RMS, one in each column over the whole grid.
    [x, y] = meshgrid(((1:n) - (n + 1) / 2) / (n / 2));
    r2 = x .^ 2 + y .^ 2;
    pupil = r2 < 1;
    modes = [
        sqrt(3) * (2 * r2(:) - 1), ...
        sqrt(6) * 2 * x(:) .* y(:), ...
        sqrt(6) * (x(:) .^ 2 - y(:) .^ 2), ...
        sqrt(8) * (3 * r2(:) - 2) .* y(:), ...
        sqrt(8) * (3 * r2(:) - 2) .* x(:), ...
        sqrt(8) * (3 * x(:) .^ 2 - y(:) .^ 2) .* y(:), ...
        sqrt(8) * (x(:) .^ 2 - 3 * y(:) .^ 2) .* x(:), ...
        sqrt(5) * (6 * r2(:) .^ 2 - 6 * r2(:) + 1)
    ];
    modes = modes .* pupil(:);
end
