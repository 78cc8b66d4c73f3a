classdef Simulator < cophase.Handle
    %SIMULATOR  A simulated AO system under a sky.
    %   s = cophase.Simulator(scene_text) builds the system that a scene (TOML) describes: turbulence, wavefront sensor,
    %   deformable mirror, control, science camera. This takes about a second at the size of Keck.
    %   s = cophase.Simulator(scene_text, directory) looks for the files that the scene names in a directory, and not in
    %   the working directory.
    %
    %   s.step(n) advances the loop by n frames; the properties show the frame made last. Maps are (y, x), single. The
    %   same scene gives the same bits as in every other language.
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       s = cophase.Simulator(cophase.preset('keck-onsky'));
    %       s.step(100);
    %       imagesc(s.image_e), axis image
    %
    %   See also cophase.preset, cophase.Model.

    properties (Dependent, SetAccess = private)
        frames          % frames since the loop was closed
        frame_s         % duration of a frame, s
        divergence_s    % time at which the loop was seen to diverge, s; NaN while it has not
        slopes_mas      % slopes: along x for every subaperture, then along y, mas
        commands_nm     % commands on the mirror, nm of wavefront
        residual_nm     % residual wavefront (y, x), nm; NaN where the pupil has no light
        residual_rms_nm % its RMS over the pupil, piston removed, nm
        image_e         % defocused image (y, x) with the scene's noise, electrons
        phasing_nm      % true phasing errors of the segments (y, x), nm; NaN outside the pupil
        ncpa_nm         % true non-common path aberrations (y, x), nm; NaN outside the pupil
    end

    methods
        function self = Simulator(scene_text, directory)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene_text is missing: the text of a scene is accepted');
            end
            if nargin < 2
                directory = '';
            end
            self.create('simulator', scene_text, directory);
        end

        function step(self, frames)
            %STEP  Advances the loop.
            %   s.step(n) advances it by n frames; by one, if n is left out. A loop that diverges goes on: see
            %   divergence_s. Ctrl-C stops between frames; what was made until then is there.
            %
            %   See also cophase.Simulator.
            if nargin < 2
                frames = 1;
            end
            % Some tens of milliseconds at a time, so that Ctrl-C is heard.
            while frames > 256
                cophase_mex('simulator.step', self.id, 256);
                frames = frames - 256;
            end
            cophase_mex('simulator.step', self.id, frames);
        end

        function value = get.frames(self)
            value = cophase_mex('simulator.frames', self.id);
        end

        function value = get.frame_s(self)
            value = cophase_mex('simulator.frame_s', self.id);
        end

        function value = get.divergence_s(self)
            value = cophase_mex('simulator.divergence_s', self.id);
        end

        function value = get.slopes_mas(self)
            value = cophase_mex('simulator.slopes_mas', self.id);
        end

        function value = get.commands_nm(self)
            value = cophase_mex('simulator.commands_nm', self.id);
        end

        function value = get.residual_nm(self)
            value = cophase_mex('simulator.residual_nm', self.id);
        end

        function value = get.residual_rms_nm(self)
            value = cophase_mex('simulator.residual_rms_nm', self.id);
        end

        function value = get.image_e(self)
            value = cophase_mex('simulator.image_e', self.id);
        end

        function value = get.phasing_nm(self)
            truth_nm = cophase_mex('simulator.truth_nm', self.id);
            value = truth_nm(:, :, 1);
        end

        function value = get.ncpa_nm(self)
            truth_nm = cophase_mex('simulator.truth_nm', self.id);
            value = truth_nm(:, :, 2);
        end
    end
end
