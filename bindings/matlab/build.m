function build(library_directory, output_directory)
    %BUILD  Compiles the gateway to libcophase, with mkoctfile under Octave and with mex in MATLAB.
    %   build() takes the library that 'cargo build --release' made in this source tree, and puts the gateway beside this
    %   file: add that folder to the path, and cophase.Simulator is there.
    %   build(library_directory, output_directory) takes and puts them elsewhere.
    here = fileparts(mfilename('fullpath'));
    root = fileparts(fileparts(here));
    if nargin < 1
        library_directory = fullfile(root, 'target', 'release');
    end
    if nargin < 2
        output_directory = here;
    end
    source = fullfile(here, 'cophase_mex.c');
    include = ['-I' fullfile(root, 'include')];
    library = ['-L' library_directory];
    if exist('OCTAVE_VERSION', 'builtin')
        output = fullfile(output_directory, 'cophase_mex.mex');
        rpath = ['-Wl,-rpath,' library_directory];
        [text, status] = mkoctfile('--mex', '-Wall', '-Wextra', include, source, library, '-lcophase', rpath, '-o', output);
        if status ~= 0
            error('cophase:BAD_FILE', 'mkoctfile failed: %s', text);
        end
    elseif ispc
        mex('-R2018a', include, source, library, '-lcophase', '-outdir', output_directory);
    else
        rpath = ['LDFLAGS=$LDFLAGS -Wl,-rpath,' library_directory];
        mex('-R2018a', include, source, library, '-lcophase', rpath, '-outdir', output_directory);
    end
end
