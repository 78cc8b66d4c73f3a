classdef Estimator < cophase.Handle
    %ESTIMATOR  The full pipeline for images of one scene, as the program does it.
    %   estimator = cophase.Estimator(scene) makes an estimator of a scene: a TOML file, the name of a preset
    %   (cophase.preset), or TOML text. The scene's estimate.method says whether the estimate is modal or maximum a
    %   posteriori (MAP, 'full-phase': the wavefront behind each exposure, static errors separated from the turbulence).
    %   With estimate.budget_nm the model is planned here, which takes some seconds. The model of an estimate is kept for
    %   the next ones, unless a file that the scene names changes. The results are those of `cophase estimate`, to the bit.
    %
    %   estimator = cophase.Estimator(scene, Name, Value, ...) chooses:
    %      'policy'     'full': modes with a prior, outlier rejection, restarts, optics fitted if the scene asks for it;
    %                   'realtime': one fit of the scene's modes, no retries, as a cophase.Session does; 'full'
    %      'threads'    number of threads, -1 for one per processor, which does not change results; -1
    %      'directory'  directory of the files that the scene names; that of the scene's file, or else the working
    %                   directory
    %   The beginning of a name is enough, in upper or lower case.
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       estimator = cophase.Estimator('scene.toml');
    %       e = estimator.estimate(frames);
    %       disp(e.report())
    %       imagesc(e.phasing_nm), axis image
    %
    %   See also cophase.Estimator.estimate, cophase.Estimate, cophase.Session, on_sky.

    methods
        function self = Estimator(scene, varargin)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene is missing: a file, a preset or the text of a scene is accepted');
            end
            [text, directory] = cophase.Handle.read_scene(scene);
            self.create('estimator.create', text, 'directory', directory, varargin{:});
        end

        function result = estimate(self, frames, varargin)
            %ESTIMATE  Estimates the static wavefront behind images.
            %   e = estimator.estimate(frames) returns a cophase.Estimate. frames holds images of the same static
            %   errors, rows x columns x images, of class single, double, uint16, int32 or uint8, two or more for a MAP
            %   estimate. rows and columns are those of the scene; of frames with one row or column more the last is left
            %   out. Values that are not finite are bad pixels. The optical axis is on row floor(rows/2) + 1 and column
            %   floor(columns/2) + 1.
            %
            %   e = estimator.estimate(frames, Name, Value, ...) chooses:
            %      'mask'          rows x columns, or rows x columns x images: bad pixels, which take no part, are not
            %                      0; none
            %      'slopes_mas'    telemetry of a MAP estimate, slopes x images: slopes of the wavefront sensor, mean
            %                      over each exposure, along x for every subaperture, then along y, NaN
            %                      for all of an image without telemetry; none
            %      'read_noise_e'  read noise of a pixel, electrons RMS, 0 for none; the scene's
            %   and the calibration, electrons = (raw - dark) * gain / flat; without it frames are electrons:
            %      'dark'          rows x columns, raw units; none
            %      'flat'          rows x columns, about 1; none
            %      'gain_e'        electrons per raw unit; image.gain_e_per_adu of the scene, or 1
            %      'saturation'    raw value from which on a pixel is saturated, and bad; none
            %   The beginning of a name is enough, in upper or lower case.
            %
            %   Images of several channels ([[image.channel]] in the scene) are a struct with a field for each, named like the
            %   channel, or a cell in the order of the scene. An option is then that of all, or a struct with the fields of
            %   those channels that have one:
            %      e = estimator.estimate(struct('plus', plus_e, 'minus', minus_e), 'gain_e', struct('plus', 4, 'minus', 5));
            %
            %   Ctrl-C stops it within a second or two, with cophase:INTERRUPTED (not in MATLAB for Windows).
            %
            %   Example:
            %       e = estimator.estimate(frames, 'slopes_mas', slopes_mas);
            %       fprintf('%.1f +- %.1f nm of phasing\n', e.info.phasing_rms_nm, e.info.phasing_sigma_nm)
            %       cellfun(@disp, e.warnings)
            %
            %   See also cophase.Estimate.
            result = cophase.Estimate(self, frames, varargin{:});
        end
    end
end
