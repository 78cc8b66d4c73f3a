% A session of several channels through the MATLAB package, under Octave, on a file of raw doubles, printed as by joint_session.c:
%
%   octave-cli joint_session.m SCENE.toml FRAMES.raw ROWS COLS
%
% The library is that of the directory COPHASE_LIBRARIES, or else of target/release; the gateway is built in the
% directory COPHASE_SCRATCH, or else in a new one.

1; % a script, not a function of this file's name

function values = doubles_of(path)
    file = fopen(path, 'r');
    values = fread(file, Inf, 'double');
    fclose(file);
end

function print_joint(report, more)
    printf('joint %s %d %s %s%s\n', report.status, report.is_contradictory, num2hex(report.reduced_chi2), ...
        num2hex(report.freedom), more);
end

root = fileparts(fileparts(fileparts(mfilename('fullpath'))));
libraries = getenv('COPHASE_LIBRARIES');
if isempty(libraries)
    libraries = fullfile(root, 'target', 'release');
end
scratch = getenv('COPHASE_SCRATCH');
if isempty(scratch)
    scratch = tempname();
    mkdir(scratch);
end
addpath(fullfile(root, 'bindings', 'matlab'), scratch);
build(libraries, scratch);

arguments = argv();
extents = str2double(arguments(3:4));
% Rows in the file are columns in memory.
frames = permute(reshape(doubles_of(arguments{2}), extents(2), extents(1), []), [2 1 3]);
frames = squeeze(mat2cell(frames, extents(1), extents(2), ones(1, size(frames, 3))));
s = cophase.JointSession(fileread(arguments{1}), 'device', 'cpu');
cellfun(@(name) printf('channel %s\n', name), s.channels);
s.calibrate(s.channels{2}, 'gain_e', 2);
s.calibrate(2);
[c, sigma_nm, report] = s.fit(cell2struct(flipud(frames), flipud(s.channels)), 'deadline_s', 3600);
assert(isequal(c, s.fit(frames)));
names = s.models{1}.mode_names;
for k = 1:numel(names)
    printf('coefficient %s %s %s\n', names{k}, num2hex(c(k)), num2hex(sigma_nm(k)));
end
for k = 1:numel(report.images)
    image = report.images(k);
    printf('image %d %s %s %d %d\n', k - 1, image.status, num2hex(image.reduced_chi2), image.is_used, image.channel - 1);
end
print_joint(report, '');
cellfun(@(sentence) printf('warning %s\n', sentence), s.warnings());
[c, covariance_nm2, report] = s.refine();
for k = 1:numel(names)
    printf('refined %s %s %s\n', names{k}, num2hex(c(k)), num2hex(covariance_nm2(k, k)));
end
print_joint(report, [' ' num2hex(report.piston_probability)]);
printf('policy %s\n', s.policy);
