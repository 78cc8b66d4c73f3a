% Model, session and sequence through the MATLAB package, under Octave; run by tests/c_api/main.rs, see there:
%
%   octave-cli session.m SCENE.toml DUMP BINDINGS LIBRARY_DIRECTORY SCRATCH
%
% DUMP receives, as doubles in C order, as in the C test: COUNT frames; their coefficients; the covariance of the first; the
% true coefficients; objectives and gradients there.

1; % a script, not a function of this file's name
source(fullfile(fileparts(mfilename('fullpath')), 'support.m'));

% Images of a star, whole electrons, (y, x, k): the PSF about the optical axis with background and noise.
function frames = frames_of(model, truth_nm)
    half = model.frame_shape / 2;
    frames = zeros([model.frame_shape, columns(truth_nm)]);
    for k = 1:columns(truth_nm)
        frames(:, :, k) = 30;
        psf = model.psf(truth_nm(:, k));
        axis = model.pixels / 2 + 1;
        reach = min(half, model.pixels / 2);
        y = -reach(1):reach(1) - 1;
        x = -reach(2):reach(2) - 1;
        frames(half(1) + 1 + y, half(2) + 1 + x, k) += 2e6 * psf(axis + y, axis + x);
    end
    frames = round(frames + sqrt(frames + 100) .* randn(size(frames)));
    assert(all(frames(:) < 65536));
    frames = max(frames, 0);
end

% Pixels of the PSF that the detector does not have.
function count = unseen(m)
    count = m.pixels ^ 2 - prod(min(m.frame_shape, m.pixels));
end

function a_model(scene, m)
    must_fail('BAD_SCENE', 'apertur', @() cophase.Model(sprintf('[pupil]\napertur = 3\n')));
    must_fail('BAD_SCENE', '', @() cophase.Model(''));
    must_fail('BAD_ARGUMENT', 'scene is', @() cophase.Model(3));
    must_fail('BAD_ARGUMENT', 'scene is', @() cophase.Model());
    must_fail('BAD_ARGUMENT', 'scene is', @() cophase.Model(['ab'; 'cd']));
    must_fail('BAD_ARGUMENT', 'directory', @() cophase.Model(scene, 3));
    must_fail('BAD_ARGUMENT', 'pupil, segments, modes or diversity_nm', @() cophase.Model(scene, '', 'pupille', 1));
    must_fail('BAD_ARGUMENT', 'no value', @() cophase.Model(scene, '', 'pupil'));
    planned = cophase.Model([scene sprintf('\n[estimate]\nbudget_nm = 20\n')]);
    assert(planned.mode_names, m.mode_names);
    assert(planned.pixels < m.pixels);
    delete(planned);
    assert(numel(m.mode_names), m.modes);
    assert(m.segment_modes > 0 && m.segment_modes < m.modes);
    assert(iscellstr(m.mode_names) && numel(unique(m.mode_names)) == m.modes);

    c = zeros(m.modes, 1);
    c(2) = 50;
    c(end) = -20;
    [phasing_nm, ncpa_nm] = m.wavefront_nm(c);
    assert(size(phasing_nm), [m.samples m.samples]);
    assert(size(ncpa_nm), [m.samples m.samples]);
    assert(any(isnan(phasing_nm(:))) && isequal(isnan(phasing_nm), isnan(ncpa_nm)));
    assert(any(abs(phasing_nm(:)) > 10) && any(abs(ncpa_nm(:)) > 1));
    assert(m.wavefront_nm(c.'), phasing_nm);
    assert(size(m.psf(c)), [m.pixels m.pixels]);
    assert(sum(m.psf(c)(:)) > 0.5 && sum(m.psf(c)(:)) < 1.001);

    must_fail('BAD_ARGUMENT', 'class single', @() m.psf(single(c)));
    must_fail('BAD_ARGUMENT', 'complex', @() m.wavefront_nm(1i * c));
    must_fail('BAD_SHAPE', sprintf('%dx1', m.modes), @() m.psf(c(2:end)));
    must_fail('BAD_SHAPE', sprintf('%dx1', m.modes), @() m.wavefront_nm([c c]));
end

function strangers(m, s, q)
    gone = cophase.Session(m);
    must_fail('BAD_ARGUMENT', 'a cophase.Model', @() cophase.Session(3));
    must_fail('BAD_ARGUMENT', 'a cophase.Model', @() cophase.Session());
    must_fail('BAD_ARGUMENT', 'this is a cophase.Session', @() cophase.Session(s));
    must_fail('BAD_ARGUMENT', 'this is a cophase.Model', @() q.push(m));
    must_fail('BAD_ARGUMENT', 'this is a cophase.Sequence', @() cophase.Sequence(q, 3));
    must_fail('BAD_ARGUMENT', 'capacity', @() cophase.Sequence(m));
    id = gone.id;
    delete(gone);
    must_fail('BAD_ARGUMENT', 'deleted', @() gone.fit(1));
    must_fail('BAD_ARGUMENT', 'deleted', @() q.push(gone));
    for forged = {id, id + 1000, -1, 0.5, NaN, Inf, uint64(s.id), uint64(18446744073709551615), 'x', {}, [], struct()}
        must_fail('BAD_ARGUMENT', 'there is no such Session', @() cophase_mex('session.fit', forged{1}, 1));
    end
    must_fail('BAD_ARGUMENT', 'this is a cophase.Model', @() cophase_mex('session.fit', m.id, 1));
    must_fail('BAD_ARGUMENT', 'this is a cophase.Session', @() cophase_mex('sequence.estimate', s.id));
    must_fail('BAD_ARGUMENT', 'no command', @() cophase_mex('session.fit', s.id));
    must_fail('BAD_ARGUMENT', 'no command', @() cophase_mex('session.unfit', s.id, 1));
    must_fail('BAD_ARGUMENT', 'use those', @() cophase_mex());
    must_fail('BAD_ARGUMENT', 'the command', @() cophase_mex(1));
end

function choices(m)
    must_fail('BAD_ARGUMENT', 'capacity is no number', @() cophase.Session(m, 'capacity', 'x'));
    must_fail('BAD_VALUE', 'capacity is 0', @() cophase.Session(m, 'capacity', 0));
    must_fail('BAD_VALUE', 'capacity is 1.5', @() cophase.Session(m, 'capacity', 1.5));
    must_fail('BAD_VALUE', 'half', @() cophase.Session(m, 'precision', 'half'));
    must_fail('BAD_ARGUMENT', 'precision', @() cophase.Session(m, 'precision', 32));
    must_fail('BAD_VALUE', 'opencil', @() cophase.Session(m, 'device', 'opencil'));
    must_fail('BAD_VALUE', 'threads', @() cophase.Session(m, 'threads', 7));
    must_fail('BAD_VALUE', 'step_tolerance_nm', @() cophase.Session(m, 'step_tolerance_nm', -1));
    must_fail('BAD_ARGUMENT', '''capacitor'' is no option', @() cophase.Session(m, 'capacitor', 1));
    must_fail('BAD_ARGUMENT', 'is no option', @() cophase.Session(m, '', 1));
    must_fail('BAD_ARGUMENT', 'the name of an option', @() cophase.Session(m, 1, 1));
    must_fail('BAD_ARGUMENT', 'no value', @() cophase.Session(m, 'capacity'));
    s = cophase.Session(m, 'capa', uint8(2), 'PREC', 'f32', 'device', [], 'max', 50);
    assert(s.device, 'cpu');
    list = cophase.devices();
    assert(list(1).name, 'cpu');
    assert(~isempty(list(1).description));
end

function wrong_frames(m, s, frames)
    frame = frames(:, :, 1);
    must_fail('BAD_SHAPE', '', @() s.fit(frame(2:end, :)));
    must_fail('BAD_SHAPE', '', @() s.fit(frame(:, 2:end)));
    must_fail('BAD_SHAPE', '3x0', @() s.fit(zeros(3, 0)));
    must_fail('BAD_SHAPE', '2x2x2x2', @() s.fit(zeros(2, 2, 2, 2)));
    must_fail('BAD_ARGUMENT', 'sparse', @() s.fit(sparse(frame)));
    must_fail('BAD_ARGUMENT', 'complex', @() s.fit(complex(frame, frame)));
    must_fail('BAD_ARGUMENT', 'int64', @() s.fit(int64(frame)));
    must_fail('BAD_ARGUMENT', 'cell', @() s.fit({frame}));
    must_fail('BAD_ARGUMENT', 'char', @() s.fit('frame'));
    must_fail('BAD_SHAPE', '3', @() s.fit(cat(3, frames, frames)));
    must_fail('BAD_VALUE', 'deadline', @() s.fit(frame, 'deadline_s', -1));
    must_fail('BAD_VALUE', 'deadline_s is 0', @() s.fit(frame, 'deadline_s', 0));
    must_fail('BAD_ARGUMENT', 'deadline_s', @() s.fit(frame, 'deadline_s', 'soon'));
    must_fail('BAD_VALUE', 'read_noise', @() s.fit(frame, 'read_noise_e', -1));
    must_fail('BAD_SHAPE', 'start_nm', @() s.fit(frame, 'start_nm', zeros(m.modes, 2)));
    must_fail('BAD_ARGUMENT', 'start_nm', @() s.fit(frame, 'start_nm', zeros(m.modes, 1, 'single')));
    must_fail('BAD_ARGUMENT', 'speed', @() s.fit(frame, 'speed', 1));
end

% Whole electrons are one estimate, whatever holds them, wherever it was cut from and in whatever company.
function layouts(m, s, frames, c)
    for class = {'single', 'uint16', 'int32'}
        assert(s.fit(cast(frames, class{1})), c);
    end
    few = min(frames, 255); % not the same stars, but the same in both classes
    assert(s.fit(uint8(few)), s.fit(few));
    large = 7 * ones(size(frames) + [9 5 2]);
    large(4:end - 6, 3:end - 3, 2:end - 1) = frames;
    assert(s.fit(large(4:end - 6, 3:end - 3, 2:end - 1)), c);
    for k = 1:columns(c)
        assert(s.fit(frames(:, :, k)), c(:, k));
    end
    assert(s.fit(frames(:, :, end:-1:1)), c(:, end:-1:1));
    for precision = {'f32', 'f64'}
        other = cophase.Session(m, 'capacity', columns(c), 'precision', precision{1}, 'threads', -1);
        difference_nm = max(abs(other.fit(frames)(:) - c(:)));
        % A tenth of an error bar; and the same computation in as many threads as there are is the same.
        assert(difference_nm <= 0.05 * strcmp(precision{1}, 'f32'));
    end
end

function reports(m, s, frames)
    [c, report] = s.fit(frames);
    assert(size(c), [m.modes, 3]);
    assert(class(c), 'double');
    assert(size(report), [3, 1]);
    assert({report.status}, {'OK', 'OK', 'OK'});
    assert([report.bad_pixels], [1 1 1] * unseen(m));
    assert(all([report.evaluations] > 1) && all([report.seconds] > 0));
    % The scatter of chi^2 of 1500 pixels or more is 0.04 at most.
    assert(all(abs([report.reduced_chi2] - 1) < 0.2));
    assert(all(abs([report.flux_e] / 2e6 - 1) < 0.01));
    assert(all(abs([report.background_e] - 30) < 3));
    assert(all(isfinite([report.tip_nm report.tilt_nm])));
    assert(~isempty(s.message(1)) && ischar(s.message(3)));
    assert(isempty(s.warnings()) && iscell(s.warnings()));
    assert(s.policy, 'realtime');
    must_fail('BAD_VALUE', 'up to 3', @() s.message(4));
    must_fail('BAD_VALUE', 'the image is 0', @() s.refine(0));
    must_fail('BAD_ARGUMENT', 'the image', @() s.refine('one'));

    % One that is dark beside two that are not.
    dark = frames;
    dark(:, :, 2) = 0;
    [c, report] = s.fit(dark);
    assert({report.status}, {'OK', 'UNUSABLE', 'OK'});
    assert(all(isnan(c(:, 2))) && all(isfinite(c(:, 1))));
    must_fail('BAD_VALUE', '', @() s.refine(2));

    % No time: nothing is raised, and every image says so.
    [~, report] = s.fit(frames, 'deadline_s', 1e-9);
    assert({report.status}, {'DEADLINE', 'DEADLINE', 'DEADLINE'});
end

function starts(s, frames, c)
    [again, report] = s.fit(frames, 'start', c, 'read_noise', 10, 'deadline', 1000);
    [~, cold] = s.fit(frames);
    assert(sum([report.evaluations]) < sum([cold.evaluations]));
    % The step at which a fit ends, many times over.
    assert(max(abs(again(:) - c(:))) < 0.5);
    [~, report] = s.fit(frames(:, :, 1), 'read_noise_e', 1000);
    assert(report.reduced_chi2 < 0.1);
    [~, report] = s.fit(frames(:, :, 1), 'read_noise_e', 0);
    assert(strcmp(report.status, 'MISFIT'));
end

% electrons = (raw - dark) * gain / flat; powers of two, so that nothing is rounded on the way.
function calibrations(m, s, frames, c)
    dark = repmat(mod(0:m.frame_shape(2) - 1, 5), m.frame_shape(1), 1);
    flat = repmat(2 .^ mod((0:m.frame_shape(1) - 1)', 2), 1, m.frame_shape(2));
    raw = frames .* flat * 2 + dark;
    s.calibrate('dark', uint16(dark), 'flat', single(flat), 'gain', 0.5);
    assert(s.fit(raw), c);
    assert(~isequal(s.fit(frames), c));
    s.calibrate('saturation', max(frames(:)));
    [~, report] = s.fit(frames);
    assert(sum([report.bad_pixels]) >= 1 + 3 * unseen(m));
    bad = false(m.frame_shape);
    bad(20, 21:23) = true;
    s.calibrate('bad', bad);
    [~, report] = s.fit(frames);
    assert([report.bad_pixels], [3 3 3] + unseen(m));
    spoilt = frames;
    spoilt(20, 21:23, :) = 60000;
    assert(s.fit(spoilt), s.fit(frames));
    must_fail('BAD_SHAPE', '', @() s.calibrate('dark', dark(:, 2:end)));
    must_fail('BAD_ARGUMENT', 'bad', @() s.calibrate('bad', 'bad'));
    must_fail('BAD_VALUE', 'gain', @() s.calibrate('gain_e', -1));
    must_fail('BAD_ARGUMENT', 'gain_e', @() s.calibrate('gain_e', [1 2]));
    must_fail('BAD_ARGUMENT', 'darkness', @() s.calibrate('darkness', dark));
    s.calibrate();
    assert(s.fit(frames), c);
end

function [f, g] = objectives(m, s, frames, truth_nm)
    fresh = cophase.Session(m);
    must_fail('BAD_VALUE', '', @() fresh.evaluate(truth_nm(:, 1)));
    must_fail('BAD_VALUE', '', @() fresh.refine());
    must_fail('BAD_VALUE', '', @() fresh.message());
    f = s.evaluate(truth_nm, frames);
    must_fail('BAD_SHAPE', 'coefficients', @() s.evaluate(truth_nm(2:end, :)));
    must_fail('BAD_ARGUMENT', 'coefficients', @() s.evaluate('x'));
    [f, g] = s.evaluate(truth_nm);
    assert(size(f), [1 3]);
    assert(size(g), size(truth_nm));
    assert(s.evaluate(truth_nm), f);
    % A central difference is off by the third derivative times step^2 / 6, and by the rounding of f over the step: both
    % are some 1e-9 of f here, and what is compared is some 1e-3 of it.
    step_nm = 1e-3;
    for mode = [2, m.modes]
        away_nm = zeros(size(truth_nm));
        away_nm(mode, :) = step_nm;
        slopes = (s.evaluate(truth_nm + away_nm) - s.evaluate(truth_nm - away_nm)) / (2 * step_nm);
        assert(max(abs(slopes - g(mode, :))) < 1e-6 * max(f));
    end
    must_fail('BAD_SHAPE', '', @() s.evaluate(truth_nm, frames(:, :, 1)));
    assert(s.evaluate(truth_nm(:, 1).', frames(:, :, 1), 'read_noise', 10), f(1));
end

function sequences(m, s, q, frames)
    must_fail('BAD_IMAGE', '', @() q.estimate());
    must_fail('BAD_IMAGE', '', @() q.images_needed(1, 1));
    must_fail('BAD_VALUE', 'capacity', @() cophase.Sequence(m, 0));
    must_fail('BAD_ARGUMENT', 'capacity', @() cophase.Sequence(m, 'all'));
    c = s.fit(frames);
    q.push(s);
    s.fit(frames(:, :, 1:2));
    q.push(s);
    e = q.estimate();
    assert(size(e.coefficients_nm), [m.modes 1]);
    assert(size(e.sigma_nm), [m.modes 1]);
    assert(e.info.images, 5);
    assert(e.info.used + e.info.clipped <= 5 && e.info.used > 0);
    assert(e.info.phasing_rms_nm > 0 && e.info.ncpa_rms_nm > 0 && e.info.phasing_sigma_nm > 0 && e.info.ncpa_sigma_nm > 0);
    assert(abs(e.info.reduced_chi2 - 1) < 0.2);
    C = e.covariance_nm2;
    assert(C, C', 1e-15 * max(C(:))); % symmetric up to rounding
    % The error bars are the roots of its diagonal, up to rounding.
    assert(sqrt(diag(C)), e.sigma_nm, 1e-9 * max(e.sigma_nm));
    assert(q.images_needed(Inf, Inf), 0);
    assert(q.images_needed(e.info.phasing_sigma_nm / 10), 5 * 99, 6); % errors fall as the root of the number
    must_fail('BAD_ARGUMENT', 'phasing_nm', @() q.images_needed('few', 1));
    must_fail('BAD_VALUE', 'phasing_nm', @() q.images_needed(-1, 1));
    for k = 1:2
        s.fit(frames);
        q.push(s);
    end
    assert(q.estimate().info.images, q.capacity);
    q.clear();
    must_fail('BAD_IMAGE', '', @() q.estimate());
end

% SIGINT stops a fit that runs, and nothing else.
function interrupts(m, frames, c)
    if ~isfolder('/proc/self/task')
        return % there is no such list of threads here
    end
    count = 3000;
    many = repmat(uint16(frames(:, :, 1)), [1 1 count]);
    s = cophase.Session(m, 'capacity', count);
    % Sent as soon as there is one thread more than now, which is the fit's.
    tasks = sprintf('ls /proc/%d/task | wc -l', getpid());
    [~, now] = system(tasks);
    system(sprintf(['(while [ $(%s) -le %d ]; do kill -0 %d || exit; sleep 0.01; done; kill -INT %d) ' ...
        '> /dev/null 2>&1 &'], tasks, str2double(now), getpid(), getpid()));
    must_fail('INTERRUPTED', 'Ctrl-C', @() s.fit(many));
    assert(s.fit(frames(:, :, 1)), c(:, 1));
    [again, report] = s.fit(many(:, :, 1:3));
    assert(again, c(:, [1 1 1]));
    assert({report.status}, {'OK', 'OK', 'OK'});
end

% A pupil and modes as OOMAO keeps them.
function arrays()
    n = 32;
    [x, y] = meshgrid(((0:n - 1) - (n - 1) / 2) / (n / 2));
    pupil = double(x .^ 2 + y .^ 2 < 0.95);
    modes = cat(3, 2 * x, sqrt(6) * (x .^ 2 - y .^ 2), sqrt(24) * x .* y, sqrt(8) * x .* (3 * (x .^ 2 + y .^ 2) - 2));
    camera = {'wavelength', 2200, 'frame_shape', 48, 'diversity_focus', 0.5, 'read_noise_e', 10};
    m = cophase.Model.from_arrays(pupil, modes, camera{:});
    assert(m.modes, 4);
    assert(m.segment_modes, 0);
    assert(m.frame_shape, [48 48]);
    assert(m.samples, n);
    truth_nm = [30; -40; 20; 15];
    [~, ncpa_nm] = m.wavefront_nm(truth_nm);
    expected_nm = sum(modes .* reshape(truth_nm, 1, 1, []), 3);
    % Maps of hundreds of nm, in double precision.
    assert(max(abs(ncpa_nm(pupil == 1) - expected_nm(pupil == 1))) < 1e-10);
    image = frames_of(m, truth_nm);
    c = cophase.Session(m).fit(image);
    assert(max(abs(c - truth_nm)) < 5); % many error bars

    matrix = reshape(modes, [], 4);
    for same = {matrix, sparse(matrix), matrix(pupil == 1, :)}
        assert(cophase.Session(cophase.Model.from_arrays(logical(pupil), same{1}, camera{:})).fit(image), c);
    end
    must_fail('BAD_SHAPE', 'modes has 7 rows', @() cophase.Model.from_arrays(pupil, ones(7, 3), camera{:}));
    must_fail('BAD_SHAPE', '', @() cophase.Model.from_arrays(pupil, modes(2:end, :, :), camera{:}));
    must_fail('BAD_VALUE', '', @() cophase.Model.from_arrays(2 * pupil, modes, camera{:}));
    must_fail('BAD_SCENE', 'wavelength_nm', @() cophase.Model.from_arrays(pupil, modes, 'frame_shape', 48));
    must_fail('BAD_ARGUMENT', 'wavelength_nm', @() cophase.Model.from_arrays(pupil, modes, 'colour', 48));

    % Two segments, and the diversity as a map.
    segments = int32((x > 0) - (pupil == 0) * 2);
    segments(pupil == 0) = -1;
    focus_nm = 1100 * sqrt(3) * (2 * (x .^ 2 + y .^ 2) - 1);
    m = cophase.Model.from_arrays(pupil, modes, camera{1:4}, 'segments', segments, 'diversity_nm', focus_nm);
    assert(m.segment_modes, 2);
    assert(m.modes, 6);
    m = cophase.Model.from_arrays(pupil, [], camera{:}, 'segments', segments, 'segment_modes', 'piston-tip-tilt', ...
        'ncpa', 'none');
    assert(m.modes, 6);
    m = cophase.Model.from_arrays(pupil, [], camera{:}, 'segments', segments, 'ncpa', 'none', 'exact_zernikes', [2 4]);
    assert(m.modes, 5);
    must_fail('BAD_SCENE', 'pupil.grid_m', @() cophase.Model.from_arrays(pupil, [], camera{:}, 'segments', segments));
    m = cophase.Model.from_arrays(pupil, [], camera{:}, 'segments', segments, 'grid_m', 10.95);
    assert(m.modes > 66);
    m = cophase.Model.from_arrays(pupil, modes, camera{:}, 'frame_shape', [48 40]);
    assert(m.frame_shape, [48 40]);
end

function ends(scene)
    % In any order: what is made of another lives on its own.
    m = cophase.Model(scene);
    s = cophase.Session(m);
    q = cophase.Sequence(m, 3);
    frame = frames_of(m, zeros(m.modes, 1));
    delete(m);
    must_fail('BAD_ARGUMENT', 'deleted', @() m.psf(0));
    s.fit(frame);
    q.push(s);
    delete(s);
    assert(q.estimate().info.images, 1);
    delete(q);
    delete(q);
    assert(~mislocked('cophase_mex'));
    % And by themselves, with what holds them.
    m = cophase.Model(scene);
    s = cophase.Session(m);
    assert(mislocked('cophase_mex'));
    m = [];
    s.fit(frame);
    s = [];
    assert(~mislocked('cophase_mex'));
end

function run(scene, dump)
    m = cophase.Model(scene);
    s = cophase.Session(m, 'capacity', 3);
    q = cophase.Sequence(m, 7);
    truth_nm = 25 * randn(m.modes, 3);
    frames = frames_of(m, truth_nm);
    c = s.fit(frames);
    [~, covariance_nm2] = s.refine();
    a_model(scene, m);
    strangers(m, s, q);
    choices(m);
    wrong_frames(m, s, frames);
    layouts(m, s, frames, c);
    reports(m, s, frames);
    starts(s, frames, c);
    calibrations(m, s, frames, c);
    [f, g] = objectives(m, s, frames, truth_nm);
    sequences(m, s, q, frames);
    interrupts(m, frames, c);

    % MATLAB's memory has columns: transposed, frames have the rows that the other languages dump.
    out = fopen(dump, 'w');
    for values = {permute(frames, [2 1 3]), c, covariance_nm2, truth_nm, f, g}
        fwrite(out, values{1}, 'double');
    end
    fclose(out);
end

[scene, dump, bindings, libraries, scratch] = argv(){:};
addpath(bindings, scratch);
build(libraries, scratch);
randn('seed', 7);
scene = fileread(scene);
run(scene, dump);
arrays();
ends(scene);
