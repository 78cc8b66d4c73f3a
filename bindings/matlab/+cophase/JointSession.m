classdef JointSession < cophase.Handle
    %JOINTSESSION  Fits of one frame of each channel of a scene, and their combination, in memory that is allocated beforehand.
    %   s = cophase.JointSession(scene) makes a session of a scene with channels ([[image.channel]]): a TOML file, the name
    %   of a preset such as 'keck-pair', or TOML text. Each channel is fitted as a cophase.Session fits a frame, to the
    %   same bits, by the policy 'realtime'. A scene with a channel in focus is refused: cophase.Estimator takes it.
    %
    %   s = cophase.JointSession(scene, Name, Value, ...) chooses 'device', 'precision', 'threads', 'max_evaluations'
    %   and 'step_tolerance_nm' as for cophase.Session, and the 'directory' of the files that the scene names, which is
    %   that of the scene's file, or else the working directory, by default.
    %
    %   Methods:
    %      fit        common modes of one frame of each channel, with error bars
    %      refine     the same with their covariance, and whole wavelengths of pistons
    %      calibrate  calibration of the frames of a channel
    %      message    reason of the status of a channel's fit
    %      warnings   what to know before using the numbers
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SHAPE, with one sentence.
    %
    %   Example:
    %       s = cophase.JointSession(cophase.preset('keck-pair'));
    %       [c, sigma, report] = s.fit(struct('plus', plus_e, 'minus', minus_e), 'deadline_s', 0.5);
    %       if report.is_contradictory, disp(s.warnings()), end
    %       [phasing_nm, ncpa_nm] = s.models{1}.wavefront_nm(c);
    %
    %   See also cophase.JointSession.fit, cophase.Session, cophase.Estimator.

    properties (SetAccess = private)
        channels % names of the channels, a cell column, in the order of the scene
        models   % model of each channel, a cell column
        device   % device that the session runs on
        policy   % its policy
    end

    methods
        function self = JointSession(scene, varargin)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene is missing: a file, a preset or the text of a scene is accepted');
            end
            [text, directory] = cophase.Handle.read_scene(scene);
            self.create('joint_session.create', text, 'directory', directory, varargin{:});
            numbers = (1:cophase_mex('joint_session.channels', self.id))';
            self.channels = arrayfun(@(k) self.text('CHANNEL_NAME', k), numbers, 'UniformOutput', false);
            self.models = arrayfun(@(k) cophase.Model(self, k), numbers, 'UniformOutput', false);
            self.device = self.text('DEVICE', 1);
            self.policy = self.text('POLICY', 1);
        end

        function [coefficients_nm, sigma_nm, report] = fit(self, frames, varargin)
            %FIT  Fits one frame of each channel, and combines the fits.
            %   [c, sigma] = s.fit(frames) returns the common modes and their error bars (1 sigma), nm, in columns; NaN unless
            %   the fits of all channels converged. frames is a struct with a field for each channel, named like it, or a cell
            %   in the order of the scene, each as for cophase.Session.fit. The error bars are those of a flat wavefront with
            %   the flux and the noise of the frames.
            %
            %   [c, sigma, report] = s.fit(frames) also returns a struct with the fields
            %      status              the worst of the channels, as cophase.Session.fit has them
            %      is_contradictory    the channels differ by more than their noise
            %      reduced_chi2        of the differences of the channels, 1 where they agree
            %      freedom             its degrees of freedom
            %      piston_probability  NaN
            %      seconds             duration
            %      images              report on each channel's own fit, as of cophase.Session.fit
            %
            %   [...] = s.fit(frames, Name, Value, ...) chooses:
            %      'deadline_s'    time for all channels together, s; none
            %      'read_noise_e'  read noise of a pixel, electrons RMS, 0 for none; each channel's own
            %      'start_nm'      start of the fits, one for each mode; zeros
            %
            %   Ctrl-C stops it, with cophase:INTERRUPTED, and the session can be used again. In MATLAB for Windows it
            %   does not: give a deadline.
            %
            %   See also cophase.JointSession.refine, cophase.JointSession.message.
            if isstruct(frames)
                if ~isempty(setxor(fieldnames(frames), self.channels))
                    error('cophase:BAD_SHAPE', 'frames has the channels %s: those of the scene, %s, are accepted', ...
                        strjoin(fieldnames(frames)', ', '), strjoin(self.channels', ', '));
                end
                frames = cellfun(@(name) frames.(name), self.channels, 'UniformOutput', false);
            end
            if ~iscell(frames)
                error('cophase:BAD_SHAPE', 'frames is a %s: a struct or a cell with a frame of each channel is accepted', ...
                    class(frames));
            end
            [values, reports] = cophase_mex('joint_session.fit', self.id, frames, varargin{:});
            coefficients_nm = values(:, 1);
            sigma_nm = values(:, 2);
            report = reports{1};
            report.images = reports{2};
            for k = 1:numel(report.images)
                report.images(k).channel = report.images(k).channel + 1;
            end
        end

        function [coefficients_nm, covariance_nm2, report] = refine(self)
            %REFINE  Combines the last fits by their information at the fitted wavefronts.
            %   [c, C, report] = s.refine() returns the common modes, nm, their covariance, nm^2, and a report as fit does,
            %   without images. It also finds the whole wavelengths of pistons, with the smallest of their probabilities in
            %   report.piston_probability: the estimate of a cophase.Estimator with the policy 'realtime'. It takes as long as
            %   some hundred evaluations of each channel.
            %
            %   See also cophase.JointSession.fit.
            [values, report] = cophase_mex('joint_session.refine', self.id);
            coefficients_nm = values(:, 1);
            covariance_nm2 = values(:, 2:end);
        end

        function calibrate(self, channel, varargin)
            %CALIBRATE  Sets the calibration of later frames of a channel.
            %   s.calibrate(channel, Name, Value, ...) as cophase.Session.calibrate; channel is a name or a number from 1.
            %
            %   See also cophase.Session.calibrate.
            cophase_mex('joint_session.calibrate', self.id, self.number_of(channel), varargin{:});
        end

        function text = message(self, channel)
            %MESSAGE  Reason of the status of a channel's last fit, a sentence.
            %   text = s.message(channel); channel is a name or a number from 1.
            %
            %   See also cophase.JointSession.fit.
            text = self.text('IMAGE_MESSAGE', self.number_of(channel));
        end

        function sentences = warnings(self)
            %WARNINGS  What to know before using the numbers, a cell of sentences.
            %   sentences = s.warnings() is on devices and models, and on channels that contradict each other in the last fit.
            %
            %   See also cophase.JointSession.fit.
            sentences = cophase.Handle.lines(self.text('WARNINGS', 1));
        end
    end

    methods (Access = private)
        function text = text(self, what, index)
            text = cophase_mex('joint_session.text', self.id, what, index);
        end

        function number = number_of(self, channel)
            number = channel;
            if ischar(channel)
                number = find(strcmp(self.channels, channel));
                if isempty(number)
                    error('cophase:BAD_VALUE', 'the channel is ''%s'': one of %s is accepted', channel, ...
                        strjoin(self.channels', ', '));
                end
            end
        end
    end
end
