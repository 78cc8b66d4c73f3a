classdef FullPhase < cophase.Handle
    %FULLPHASE  Static errors from a sequence of exposures behind adaptive optics.
    %   f = cophase.FullPhase(scene_text) makes the estimator of `cophase estimate --method full-phase`: the whole
    %   wavefront behind each exposure, and from all of them together the pistons of the segments and the non-common
    %   path aberrations (NCPA). With [wavefront_sensor] and [control] the scene (TOML) describes the loop in front of
    %   the camera.
    %   f = cophase.FullPhase(scene_text, directory) looks for the files that the scene names in a directory, and not
    %   in the working directory.
    %
    %   Methods:
    %      estimate      static errors of a sequence, with their error bars
    %      corrections   what to add to segments, mirror and reference slopes
    %      imagesNeeded  how many more images an accuracy asks for
    %      calibrate     what the camera's raw values mean
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       f = cophase.FullPhase(cophase.preset('keck-onsky'));
    %       e = f.estimate(frames, 'Slopes_mas', slopes_mas);
    %       imagesc(e.Phasing_nm), axis image
    %
    %   See also cophase.FullPhase.estimate, cophase.FullPhase.corrections, cophase.Simulator, on_sky.

    properties (SetAccess = private)
        FrameSize % rows and columns of a frame
    end

    methods
        function self = FullPhase(scene_text, directory)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene_text is missing: the text of a scene is accepted');
            end
            if nargin < 2
                directory = '';
            end
            self.create('full_phase', scene_text, directory);
            self.FrameSize = cophase_mex('full_phase.frame_size', self.id);
        end

        function result = estimate(self, frames, varargin)
            %ESTIMATE  Static errors of a sequence.
            %   e = f.estimate(frames) reads two or more exposures of the same static errors, rows x columns x count,
            %   f.FrameSize each, of class single, double, uint16, int32 or uint8. Values are electrons, unless
            %   calibrate said what they mean. NaN masks a pixel. 75 exposures of Keck take some ten seconds on two
            %   processors.
            %
            %   e = f.estimate(frames, Name, Value, ...) chooses:
            %      'Slopes_mas'   telemetry, slopes x count: what the wavefront sensor measured meanwhile, mean over each
            %                     exposure, along x for every subaperture, then along y; none
            %      'Knows'        what is assumed of the adaptive optics, each with all before it: 'nothing', 'spectrum',
            %                     'loop' or 'telemetry'; what the scene says, or else the most that there is
            %      'ReadNoise_e'  of a pixel, electrons RMS; what the scene says
            %      'Threads'      0 for as many as the machine has processors; 0
            %   The beginning of a name is enough, whatever its case.
            %
            %   It returns a struct with the fields
            %      Phasing_nm, Ncpa_nm            maps (y, x), single, nm; NaN outside the pupil
            %      PhasingSigma_nm, NcpaSigma_nm  RMS over the pupil of their error bars, nm
            %      PhasingRms_nm, NcpaRms_nm      RMS over the pupil, tip and tilt removed, nm
            %      PhasingSigmaMap_nm, NcpaSigmaMap_nm  error bars as maps, 1 sigma
            %      Names, SegmentModes            the static modes; the first SegmentModes are pistons
            %      Coefficients_nm, Sigma_nm      a column each, nm, and 1 sigma
            %      Covariance_nm2                 of the coefficients
            %      Images, Used                   how many were read; how many were used
            %      Passes, Settled                how many were made; whether the last one changed next to nothing
            %      PhasingChange_nm, NcpaChange_nm  by how much it did, RMS over the pupil
            %      Knows                          what was assumed of the adaptive optics
            %      ReducedChi2                    median of the images used; 4 to 5 behind a bright star
            %      Seconds                        it took
            %      Reports                        a struct for each image: Status ('OK', 'NOT_CONVERGED', 'UNUSABLE'),
            %                                     Used, Evaluations, ReducedChi2, Flux_e, Background_e, Message
            %      Warnings                       what to know before using it, a cell of sentences
            %
            %   Ctrl-C stops it within a second or two, with cophase:INTERRUPTED (not in MATLAB for Windows).
            %
            %   Example:
            %       e = f.estimate(frames, 'Slopes_mas', slopes_mas);
            %       fprintf('%.1f +- %.1f nm of phasing\n', e.PhasingRms_nm, e.PhasingSigma_nm)
            %       cellfun(@disp, e.Warnings)
            %
            %   See also cophase.FullPhase.corrections, cophase.FullPhase.imagesNeeded, cophase.FullPhase.calibrate.
            result = cophase_mex('full_phase.estimate', self.id, frames, varargin{:});
            names = {'Phasing_nm', 'Ncpa_nm', 'PhasingSigmaMap_nm', 'NcpaSigmaMap_nm'};
            for k = 1:4
                result.(names{k}) = result.Maps_nm(:, :, k);
            end
            result = rmfield(result, 'Maps_nm');
            if isempty(result.Warnings)
                result.Warnings = {};
            else
                result.Warnings = strsplit(result.Warnings, sprintf('\n'))';
            end
        end

        function result = corrections(self, limit_nm)
            %CORRECTIONS  What the last estimate calls for.
            %   c = f.corrections() returns a struct with the fields
            %      Pistons_nm      to add to each segment's piston, nm of wavefront; 0 where its estimate is under its
            %                      error bar
            %      Actuators_nm    to add to each command of the mirror, nm of wavefront; empty without a loop
            %      Actuators_m     2 x actuators: where each is, x and y, m
            %      Slopes_mas      to add to the sensor's reference, along x for every subaperture, then along y
            %      CorrectedModes  NCPA modes that are corrected
            %      Limited         commands that were cut at the limit
            %   They are in the library's order; a positive command raises the wavefront.
            %
            %   c = f.corrections(limit_nm) has no larger command; without it the mirror's stroke is the limit, and for
            %   segments a quarter of the wavelength.
            %
            %   Example:
            %       c = f.corrections(200);
            %       pistons_nm = pistons_nm + c.Pistons_nm;
            %
            %   See also cophase.FullPhase.estimate.
            if nargin < 2
                limit_nm = NaN;
            end
            result = cophase_mex('full_phase.corrections', self.id, limit_nm);
        end

        function images = imagesNeeded(self, phasing_nm, ncpa_nm)
            %IMAGESNEEDED  How many more images an accuracy asks for.
            %   n = f.imagesNeeded(phasing_nm, ncpa_nm) returns the number of further images like those of the last
            %   estimate until both error bars, RMS over the pupil, are at most these. Inf asks nothing of one. An error
            %   below what all images share (an error of the diversity, NCPA finer than the modes) is refused.
            %
            %   Example:
            %       n = f.imagesNeeded(4, Inf);
            %
            %   See also cophase.FullPhase.estimate.
            if nargin < 3
                ncpa_nm = Inf;
            end
            images = cophase_mex('full_phase.images_needed', self.id, phasing_nm, ncpa_nm);
        end

        function calibrate(self, varargin)
            %CALIBRATE  Says what the camera's raw values mean.
            %   f.calibrate(Name, Value, ...) makes electrons = (raw - dark) * gain / flat of coming frames, with the
            %   names of cophase.Session.calibrate; f.calibrate() forgets it: values are electrons again.
            %
            %   Example:
            %       f.calibrate('Dark', mean(darks, 3), 'Gain_e', 4)
            %
            %   See also cophase.Session.calibrate, cophase.FullPhase.estimate.
            cophase_mex('full_phase.calibrate', self.id, varargin{:});
        end
    end
end
