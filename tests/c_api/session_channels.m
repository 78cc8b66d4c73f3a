% A session of several channels through the MATLAB package, under Octave, on a file of raw doubles, printed as by session_channels.c:
%
%   octave-cli session_channels.m SCENE.toml FRAMES.raw ROWS COLS
%
% The library is that of the directory COPHASE_LIBRARIES, or else of target/release; the gateway is built in the
% directory COPHASE_SCRATCH, or else in a new one.

1; % a script, not a function of this file's name

function values = doubles_of(path)
    file = fopen(path, 'r');
    values = fread(file, Inf, 'double');
    fclose(file);
end

function print_group(report, more)
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
m = cophase.Model(fileread(arguments{1}));
s = cophase.Session(m, 'device', 'cpu', 'capacity', 2);
cellfun(@(name) printf('channel %s\n', name), s.channels);
s.calibrate('gain_e', 2, 'channel', s.channels{2});
s.calibrate('channel', 2);
[c, images, group] = s.fit(cell2struct(flipud(frames), flipud(s.channels)), 'deadline_s', 3600);
sigma_nm = group.sigma_nm;
assert(isequal(c, s.fit(frames)));
names = m.mode_names;
assert(isequal(m.channel(s.channels{2}).mode_names, names) && isequal(m.channel(2).channels, s.channels(2)));
for k = 1:numel(names)
    printf('coefficient %s %s %s\n', names{k}, num2hex(c(k)), num2hex(sigma_nm(k)));
end
assert(size(images), [2, 1]);
for k = 1:numel(images)
    image = images(k);
    printf('image %d %s %s %d %d\n', k - 1, image.status, num2hex(image.reduced_chi2), image.is_used, image.channel - 1);
end
print_group(group, '');
cellfun(@(sentence) printf('warning %s\n', sentence), s.warnings());
% Two groups in one call: each has the bits of a call of its own.
both = cellfun(@(frame) cat(3, frame, frame), frames, 'UniformOutput', false);
[twice, images, groups] = s.fit(both);
assert(isequal(twice, [c, c]) && isequal([groups.sigma_nm], [sigma_nm, sigma_nm]) && isequal(size(images), [2, 2]));
assert([images(2, :).channel], [2, 2]);
assert(~isempty(s.message(2, s.channels{2})));
[c, covariance_nm2, group] = s.refine(2);
for k = 1:numel(names)
    printf('refined %s %s %s\n', names{k}, num2hex(c(k)), num2hex(covariance_nm2(k, k)));
end
print_group(group, [' ' num2hex(group.piston_probability)]);
printf('policy %s\n', s.policy);
