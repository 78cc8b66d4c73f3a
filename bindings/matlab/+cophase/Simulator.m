classdef Simulator < cophase.Handle
    %SIMULATOR  Simulator of an AO system: turbulence, wavefront sensor, mirror, control, science camera.
    %   s = cophase.Simulator(scene) builds the system of a scene: a TOML file, the name of a preset (cophase.preset), or
    %   TOML text. This takes about a second at the size of Keck.
    %   s = cophase.Simulator(scene, directory) has the directory of the files that the scene names; that of the scene's
    %   file, or else the working directory, by default.
    %
    %   s.step(n) advances the loop by n frames; the properties are those of the last frame. Maps are (y, x), double.
    %   The same scene gives the same bits in every language.
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       s = cophase.Simulator(cophase.preset('keck-onsky'));
    %       s.step(100);
    %       imagesc(s.image_e), axis image
    %
    %   See also cophase.preset, cophase.Estimator.

    properties (Dependent, SetAccess = private)
        info            % slopes, actuators, residual_samples, truth_samples, rows, cols: sizes; frames since the loop
                        % was closed; frame_s of each; divergence_s, time at which the loop diverged, NaN while it has
                        % not; residual_rms_nm over the pupil, piston removed
        warnings        % what to know before using the images, a cell of sentences: a grid that is too coarse for them
        slopes_mas      % measured slopes, along x for every subaperture, then along y, mas
        commands_nm     % commands on the mirror, nm of wavefront
        residual_nm     % residual wavefront (y, x), nm; NaN where the pupil has no light
        image_e         % defocused image (y, x) with the scene's noise, electrons
        phasing_nm      % true phasing errors of the segments (y, x), nm; NaN outside the pupil
        ncpa_nm         % true non-common path aberrations (y, x), nm; NaN outside the pupil
    end

    methods
        function self = Simulator(scene, directory)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene is missing: a file, a preset or the text of a scene is accepted');
            end
            [text, folder] = cophase.Handle.read_scene(scene);
            if nargin < 2 || isempty(directory)
                directory = folder;
            end
            self.create('simulator.create', text, directory);
        end

        function step(self, frames)
            %STEP  Advances the loop.
            %   s.step(n) advances it by n frames; by one, if n is left out. A loop that diverges goes on: see
            %   info.divergence_s. Ctrl-C stops between frames; those made until then remain.
            %
            %   See also cophase.Simulator.
            if nargin < 2
                frames = 1;
            end
            % Some tens of milliseconds at a time, for Ctrl-C.
            while frames > 256
                cophase_mex('simulator.step', self.id, 256);
                frames = frames - 256;
            end
            cophase_mex('simulator.step', self.id, frames);
        end

        function value = get.info(self)
            value = cophase_mex('simulator.info', self.id);
        end

        function value = get.warnings(self)
            value = cophase.Handle.lines(cophase_mex('simulator.text', self.id, 'WARNINGS'));
        end

        function value = get.slopes_mas(self)
            value = cophase_mex('simulator.array', self.id, 'SLOPES_MAS', self.info.slopes);
        end

        function value = get.commands_nm(self)
            value = cophase_mex('simulator.array', self.id, 'COMMANDS_NM', self.info.actuators);
        end

        function value = get.residual_nm(self)
            samples = self.info.residual_samples;
            value = self.maps_of('RESIDUAL_NM', samples, samples, 1);
        end

        function value = get.image_e(self)
            value = self.maps_of('IMAGE_E', self.info.rows, self.info.cols, 1);
        end

        function value = get.phasing_nm(self)
            truth_nm = self.truth_nm();
            value = truth_nm(:, :, 1);
        end

        function value = get.ncpa_nm(self)
            truth_nm = self.truth_nm();
            value = truth_nm(:, :, 2);
        end
    end

    methods (Access = private)
        function maps = truth_nm(self)
            samples = self.info.truth_samples;
            maps = self.maps_of('TRUTH_NM', samples, samples, 2);
        end

        function maps = maps_of(self, what, rows, cols, count)
            maps = cophase.Handle.maps(cophase_mex('simulator.array', self.id, what, rows * cols * count), rows, cols);
        end
    end
end
