function residual_nm = on_sky(images, directory)
    %ON_SKY  Segments and NCPA from exposures behind adaptive optics.
    %   on_sky() takes short exposures of a small telescope of Keck's segments behind a simulated loop, estimates
    %   pistons and NCPA from them and from the slopes of the wavefront sensor, and writes on_sky.png to the working
    %   directory: truth, estimate, residual and error bar of both.
    %
    %   residual_nm = on_sky(images, directory) takes that many exposures (10), writes to another directory, and returns
    %   the residuals of phasing and NCPA, nm RMS over the pupil.
    %
    %   Example:
    %       on_sky(20, tempdir)
    %
    %   See also cophase.Estimator, cophase.Simulator, artificial_source.
    if nargin < 1
        images = 10;
    end
    if nargin < 2
        directory = '.';
    end
    scene = small_scene(cophase.preset('keck-onsky'));
    sky = cophase.Simulator(scene);
    sky.step(1000); % the loop has closed
    for k = 1:images
        sky.step(300);
        frames(:, :, k) = sky.image_e;
        slopes_mas(:, k) = sky.slopes_mas;
    end

    estimator = cophase.Estimator(scene);
    e = estimator.estimate(frames, 'slopes_mas', slopes_mas);
    disp(e.report())
    c = e.correct();
    fprintf('%d NCPA modes to correct\n', c.corrected_modes);

    truth = {sky.phasing_nm, sky.ncpa_nm};
    found = {e.phasing_nm, e.ncpa_nm};
    bars = {e.phasing_sigma_nm, e.ncpa_sigma_nm};
    sigma_nm = [e.info.phasing_sigma_nm, e.info.ncpa_sigma_nm];
    names = {'phasing', 'NCPA'};
    for k = 1:2
        residual{k} = flat(found{k} - truth{k});
        residual_nm(k) = rms_nm(residual{k});
        fprintf('%-8s %5.1f nm RMS, residual %.1f, one sigma %.1f\n', names{k}, rms_nm(flat(truth{k})), ...
            residual_nm(k), sigma_nm(k));
    end
    show(names, {truth, found, residual, bars}, fullfile(directory, 'on_sky.png'));
end

function scene = small_scene(scene)
    % Seven segments need less time, with less defocus for a smaller detector; turbulence is frozen during each
    % exposure. Method: the wavefront behind each exposure, static errors separated from the turbulence (MAP).
    changes = {'aperture  = "keck"', 'aperture = "hexagonal"'; 'rings     = 3', 'rings = 1'; ...
        'grid_m    = 11.25', 'grid_m = 5.625'; 'samples   = 120', 'samples = 64'; 'pixels    = 240', 'pixels = 128'; ...
        'exposure_s = 0.010', 'exposure_s = 0.0'; 'diversity_focus_waves_rms = 1.5', 'diversity_focus_waves_rms = 1.0'; ...
        'lenslets_across = 20', 'lenslets_across = 10'; ...
        'actuators_across = 21', 'actuators_across = 11'};
    for k = 1:size(changes, 1)
        assert(~isempty(strfind(scene, changes{k, 1})), 'the preset has no "%s"', changes{k, 1});
        scene = strrep(scene, changes{k, :});
    end
    scene = [scene, sprintf('\n[estimate]\nmethod = "full-phase"\n')];
end

function map = flat(map)
    % A map without piston, tip and tilt.
    inside = ~isnan(map);
    [y, x] = find(inside);
    planes = [ones(numel(x), 1), x, y];
    values = map(inside);
    map(inside) = values - planes * (planes \ values);
end

function value = rms_nm(map)
    value = sqrt(mean(map(~isnan(map)) .^ 2));
end

function show(names, columns, file)
    if exist('OCTAVE_VERSION', 'builtin') && isempty(available_graphics_toolkits())
        fprintf('%s is not written: this Octave has no graphics toolkit, such as gnuplot\n', file);
        return
    end
    titles = {'truth', 'estimate', 'residual', 'one sigma'};
    % Without a window, so that it needs no display.
    picture = figure('Visible', 'off', 'PaperUnits', 'inches', 'PaperPosition', [0, 0, 14, 7]);
    for row = 1:2
        for column = 1:4
            subplot(2, 4, 4 * (row - 1) + column);
            map = double(columns{column}{row});
            map(isnan(map)) = min(map(:));
            imagesc(map);
            set(gca, 'YDir', 'normal');
            axis image off
            colorbar
            title(sprintf('%s %s (nm)', names{row}, titles{column}));
        end
    end
    print(picture, file, '-dpng', '-r100');
    close(picture);
    fprintf('wrote %s\n', file);
end
