function build(library_directory, output_directory)
    %BUILD  Compiles the gateway to libcophase, with mkoctfile under Octave and with mex in MATLAB.
    %   build() takes the library that 'cargo build --release' made in this source tree, and puts the gateway beside
    %   this file: add that folder to the path, and the package cophase is there.
    %   build(library_directory, output_directory) takes and puts them elsewhere.
    %
    %   Example:
    %       cd bindings/matlab
    %       build
    %       addpath(pwd)
    %
    %   See also cophase.Estimator, cophase.Model, cophase.Session, cophase.Simulator.
    here = fileparts(mfilename('fullpath'));
    root = fileparts(fileparts(here));
    if nargin < 1
        library_directory = fullfile(root, 'target', 'release');
    end
    if nargin < 2
        output_directory = here;
    end
    if isempty(dir(fullfile(library_directory, '*cophase.*')))
        error('cophase:BAD_FILE', ['%s holds no libcophase: run ''cargo build --release'', or give the folder of an installed ' ...
            'one, build(''/prefix/lib'')'], library_directory);
    end
    files = {'cophase_mex', 'arguments', 'handles', 'interrupt', 'model', 'estimate', 'session', 'sequence', 'simulator'};
    sources = strcat(fullfile(here, 'gateway', files), '.c');
    include = ['-I' fullfile(root, 'include')];
    library = {['-L' library_directory], '-lcophase'};
    if exist('OCTAVE_VERSION', 'builtin')
        output = fullfile(output_directory, 'cophase_mex.mex');
        rpath = ['-Wl,-rpath,' library_directory];
        % A command has the arguments that commands have, whether it needs them or not.
        warnings = {'-Wall', '-Wextra', '-Wno-unused-parameter'};
        [text, status] = mkoctfile('--mex', warnings{:}, include, sources{:}, library{:}, rpath, '-o', output);
        if status ~= 0
            error('cophase:BAD_FILE', 'mkoctfile failed: %s', text);
        end
    elseif ispc
        mex('-R2018a', include, sources{:}, library{:}, '-output', 'cophase_mex', '-outdir', output_directory);
    else
        % libut tells of Ctrl-C.
        rpath = ['LDFLAGS=$LDFLAGS -Wl,-rpath,' library_directory];
        mex('-R2018a', include, sources{:}, library{:}, '-lut', rpath, '-output', 'cophase_mex', ...
            '-outdir', output_directory);
    end
end
