function residual_nm = artificial_source(draws, directory)
    %ARTIFICIAL_SOURCE  Segments and NCPA from one image of a source inside the telescope.
    %   artificial_source() draws aberrations of Keck as section 3 of Lamb et al. (2021) does, takes a defocused image of them
    %   with noise, estimates them from that image alone, and writes two pictures to the working directory:
    %      artificial_source_maps.png       image, truth, estimate and residual of the first draw
    %      artificial_source_residuals.png  residuals of all draws, and those that were published
    %
    %   residual_nm = artificial_source(draws, directory) makes that many draws (8), writes to another directory, and
    %   returns the residuals of each draw, nm RMS over the pupil: phasing in the first column, NCPA in the second.
    %
    %   Example:
    %       artificial_source(3, tempdir)
    %
    %   See also cophase.Model, cophase.Session, oomao_style.
    if nargin < 1
        draws = 8;
    end
    if nargin < 2
        directory = '.';
    end
    scene = cophase.preset('keck-artificial');
    source = cophase.Model(source_scene(scene));
    model = cophase.Model(scene);
    session = cophase.Session(model, 'threads', -1);

    residual_nm = zeros(draws, 2);
    for draw = 1:draws
        truth_nm = draw_aberrations(source, draw);
        frame = camera(source, truth_nm);
        [c, report] = session.fit(frame);
        maps = compare(source, truth_nm, model, c);
        residual_nm(draw, :) = [rms_nm(maps{1, 3}), rms_nm(maps{2, 3})];
        fprintf('draw %2d: phasing %.3f nm, NCPA %.3f nm, chi2 %.2f, %s, %.2f s\n', draw, residual_nm(draw, :), ...
            report.reduced_chi2, report.status, report.seconds);
        if draw == 1
            save_picture(@() show_maps(frame, maps), fullfile(directory, 'artificial_source_maps.png'));
        end
    end
    save_picture(@() show_residuals(residual_nm), fullfile(directory, 'artificial_source_residuals.png'));
end

function scene = source_scene(scene)
    % The telescope of the image: finer samples than the estimate's, the modes of the truth, all pixels of the detector.
    scene = regexprep(scene, 'samples   = 120[^\n]*', 'samples = 240');
    scene = regexprep(scene, 'ncpa    = "kl"[^\n]*', 'ncpa = "zernike"');
    scene = regexprep(scene, 'ncpa_count = 66', sprintf('ncpa_count = 17\nexact_zernikes = []'));
    scene = regexprep(scene, 'pixels    = 480', sprintf('pixels = 480\ncrop_pixels = 480'));
    scene = [scene, sprintf('\n[estimate]\nsampling = "native"\n')];
end

function truth_nm = draw_aberrations(source, seed)
    % Pistons of 64.15 nm RMS, Zernikes 4 to 18 of 72.7 nm RMS whose variance falls as the square of their radial order.
    randn('state', seed);
    pistons = randn(source.segment_modes, 1);
    pistons = pistons - mean(pistons);
    noll = 2:source.modes - source.segment_modes + 1;
    order = ceil((sqrt(8 * noll + 1) - 3) / 2);
    zernikes = randn(numel(noll), 1) ./ order';
    zernikes(noll < 4) = 0;
    truth_nm = [64.15 * pistons / sqrt(mean(pistons .^ 2)); 72.7 * zernikes / norm(zernikes)];
end

function frame = camera(source, truth_nm)
    % Electrons: a signal to noise ratio of 500 at the brightest pixel, read noise of 60.
    psf = source.psf(truth_nm);
    peak_e = (500 ^ 2 + sqrt(500 ^ 4 + 4 * (500 * 60) ^ 2)) / 2;
    star_e = psf * peak_e / max(psf(:));
    frame = star_e + sqrt(star_e + 60 ^ 2) .* randn(size(psf));
end

function maps = compare(source, truth_nm, model, c)
    % Rows: phasing, NCPA. Columns: truth, estimate, residual. All on the estimate's grid, without piston, tip and tilt,
    % which phasing and NCPA share. The pistons are the first coefficients of both models.
    pistons_nm = zeros(model.modes, 1);
    pistons_nm(1:model.segment_modes) = truth_nm(1:source.segment_modes);
    [~, ncpa_nm] = source.wavefront_nm(truth_nm);
    truth = {model.wavefront_nm(pistons_nm), coarser(ncpa_nm, model.samples)};
    [estimate{1:2}] = model.wavefront_nm(c);
    maps = cell(2, 3);
    for part = 1:2
        maps{part, 1} = flattened(truth{part});
        maps{part, 2} = flattened(estimate{part});
        maps{part, 3} = flattened(maps{part, 2} - maps{part, 1});
    end
end

function map = coarser(map, samples)
    % Means over blocks; NaN, which is left out, if a block is not wholly inside the pupil.
    block = size(map, 1) / samples;
    map = reshape(map, block, samples, block, samples);
    map = squeeze(mean(mean(map, 1), 3));
end

function map = flattened(map)
    [x, y] = meshgrid(linspace(-1, 1, size(map, 1)));
    inside = isfinite(map);
    plane = [ones(nnz(inside), 1), x(inside), y(inside)];
    map(inside) = map(inside) - plane * (plane \ map(inside));
end

function value = rms_nm(map)
    value = sqrt(mean(map(isfinite(map)) .^ 2));
end

function show_maps(frame, maps)
    titles = {'truth', 'estimate', 'residual'};
    parts = {'phasing', 'NCPA'};
    subplot(2, 4, [1 5]);
    middle = size(frame, 1) / 2 + (-80:79);
    imagesc(sqrt(max(frame(middle, middle), 0)));
    set(gca, 'YDir', 'normal');
    axis image off
    title('image (square root)');
    for part = 1:2
        for column = 1:3
            subplot(2, 4, 4 * (part - 1) + column + 1);
            map = maps{part, column};
            map(~isfinite(map)) = min(map(:));
            imagesc(map);
            set(gca, 'YDir', 'normal');
            axis image off
            colorbar
            title(sprintf('%s %s: %.3g nm', parts{part}, titles{column}, rms_nm(maps{part, column})));
        end
    end
end

function show_residuals(residual_nm)
    draws = size(residual_nm, 1);
    semilogy(1:draws, residual_nm(:, 1), 'o', 1:draws, residual_nm(:, 2), 'd', [0.5, draws + 0.5], [4.4, 4.4], '--', ...
        [0.5, draws + 0.5], [7.2, 7.2], '--');
    axis([0.5, draws + 0.5, 0.01, 100]);
    grid on
    xlabel('draw');
    ylabel('residual (nm RMS)');
    title('One image of an artificial source: residual of each draw');
    legend('phasing', 'NCPA', 'published: phasing', 'published: NCPA', 'Location', 'east');
end

function save_picture(draw, file)
    if exist('OCTAVE_VERSION', 'builtin') && isempty(available_graphics_toolkits())
        fprintf('%s is not written: this Octave has no graphics toolkit, such as gnuplot\n', file);
        return
    end
    % Without a window, so that it needs no display.
    picture = figure('Visible', 'off', 'PaperUnits', 'inches', 'PaperPosition', [0, 0, 14, 7]);
    draw();
    print(picture, file, '-dpng', '-r100');
    close(picture);
    fprintf('wrote %s\n', file);
end
