classdef Session < cophase.Handle
    %SESSION  Fits of images with a model, in memory that is allocated when the session is created.
    %   A frame of each channel of the model is a group, which sees one wavefront: an image of a model with one channel. The
    %   frames of a group are fitted together, with the modes in common and each its own tip, tilt, flux and background.
    %
    %   s = cophase.Session(model) follows the policy 'realtime': no modes with a prior, but for channels none of which
    %   determines the wavefront by itself, no restarts; cophase.Estimator is the full pipeline. The model may be deleted
    %   afterwards.
    %
    %   s = cophase.Session(model, Name, Value, ...) chooses:
    %      'capacity'           largest number of groups of a call, which are images with one channel; 1
    %      'precision'          'f64' or 'f32' of the computation, for frames of any class; the scene's
    %      'device'             'cpu', 'auto', 'opencl' or a name of cophase.devices; the scene's
    %      'threads'            threads of the CPU: 1 for the caller's own, -1 for one per processor; 1
    %      'max_evaluations'    largest number of evaluations for one image; the scene's
    %      'step_tolerance_nm'  a fit stops where neither a coefficient nor the RMS of the wavefront would change by
    %                           more than this; the scene's
    %   The beginning of a name is enough, in upper or lower case.
    %
    %   Methods:
    %      fit        coefficients of images, and a report on each
    %      calibrate  calibration of the frames
    %      refine     coefficients with their covariance; of several channels also the whole wavelengths of pistons
    %      message    reason of the status of an image
    %      warnings   what to know before using the numbers
    %      evaluate   objective and gradient, for an optimizer of the caller's
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SHAPE, with one sentence.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %       s = cophase.Session(m, 'capacity', 8);
    %       [c, report] = s.fit(frames);                 % rows x columns x 8, electrons
    %       [phasing_nm, ncpa_nm] = m.wavefront_nm(c(:, 1));
    %
    %       s = cophase.Session(cophase.Model(cophase.preset('keck-pair')));
    %       [c, report, group] = s.fit(struct('plus', plus_e, 'minus', minus_e), 'deadline_s', 0.5);
    %       if group.is_contradictory, disp(s.warnings()), end
    %
    %   See also cophase.Session.fit, cophase.Session.calibrate, cophase.Model, cophase.Sequence, cophase.devices.

    properties (SetAccess = private)
        model    % model that is fitted
        channels % names of its channels, a cell column
        device   % device that the session runs on
        policy   % its policy
    end

    methods
        function self = Session(model, varargin)
            if nargin < 1
                model = [];
            end
            self.create('session.create', cophase.Handle.number(model), varargin{:});
            self.model = model;
            self.channels = model.channels;
            self.device = self.text('DEVICE', 1, 1);
            self.policy = self.text('POLICY', 1, 1);
        end

        function [coefficients_nm, report, group] = fit(self, frames, varargin)
            %FIT  Fits the model to images.
            %   c = s.fit(frames) returns the coefficients, nm, of each image in a column: m.modes x count, double.
            %   frames is rows x columns x count, m.frame_shape each, of class single, double, uint16, int32 or uint8,
            %   and is not copied. Values are electrons without a calibration. Values that are not finite are bad
            %   pixels. The optical axis is on row rows/2 + 1 and column columns/2 + 1.
            %
            %   [c, report] = s.fit(frames) also returns a struct for each image, with the fields
            %      status         'OK'; 'MISFIT' if the residual differs from the noise; 'WRONG_MINIMUM';
            %                     'NOT_CONVERGED'; 'UNUSABLE', with coefficients of NaN; 'DEADLINE', the best so far
            %      bad_pixels     pixels that were marked
            %      evaluations    of objective and gradient
            %      reduced_chi2   1 where the model is right
            %      flux_e, background_e, tip_nm, tilt_nm
            %      seconds        duration of the fit
            %      rejected_pixels  outlier pixels
            %      channel        number of its channel
            %   and is_used, is_clipped, which are 0 with one channel.
            %
            %   Of several channels, frames is a struct with a field for each, named like it, or a cell in the order of
            %   s.channels. The coefficients of a group are the modes that they have in common, NaN unless all its frames can be
            %   used and the fit converged; report is channels x count. [c, report, group] = s.fit(frames) also returns a
            %   struct for each group:
            %      status            the worst of its images
            %      sigma_nm          error bars (1 sigma) of the coefficients, in a column: those of a flat wavefront with
            %                        the flux and the noise of the frames; NaN with one channel, see refine
            %      is_contradictory  the channels differ by more than their noise
            %      reduced_chi2      of the differences of the channels, 1 where they agree
            %      freedom           its degrees of freedom
            %      piston_probability  NaN
            %      seconds           duration of its fits
            %
            %   [...] = s.fit(frames, Name, Value, ...) chooses:
            %      'deadline_s'    time for the whole call, s; none
            %      'read_noise_e'  read noise of a pixel, electrons RMS, 0 for none; each channel's own
            %      'start_nm'      starts of the fits, m.modes x count, each for all channels; zeros
            %
            %   Ctrl-C stops it, with cophase:INTERRUPTED, and the session can be used again. In MATLAB for Windows it
            %   does not: give a deadline.
            %
            %   Example:
            %       [c, report] = s.fit(frames, 'deadline_s', 0.5);
            %       bad = find(~strcmp({report.status}, 'OK'));
            %       for k = bad, disp(s.message(k)), end
            %
            %   See also cophase.Session.message, cophase.Session.refine, cophase.Session.calibrate, cophase.Sequence.
            results = cell(1, max(nargout, 1) + (nargout > 2)); % error bars come with the reports on groups
            [results{:}] = cophase_mex('session.fit', self.id, self.by_channel(frames), varargin{:});
            coefficients_nm = results{1};
            if nargout > 1
                numbers = num2cell([results{2}.channel] + 1);
                report = results{2};
                [report.channel] = numbers{:};
                if numel(self.channels) > 1
                    report = reshape(report, numel(self.channels), []);
                end
            end
            if nargout > 2
                group = results{3};
                sigmas_nm = num2cell(results{4}, 1);
                [group.sigma_nm] = sigmas_nm{:};
            end
        end

        function calibrate(self, varargin)
            %CALIBRATE  Sets the calibration of later frames of a channel.
            %   s.calibrate(Name, Value, ...) makes electrons = (raw - dark) * gain / flat:
            %      'dark'        rows x columns, raw units; none
            %      'flat'        rows x columns, about 1; none
            %      'bad'         rows x columns, logical or numeric: bad pixels, which take no part, are not 0; none
            %      'gain_e'      electrons per raw unit; image.gain_e_per_adu of the scene, or 1
            %      'saturation'  raw value from which on a pixel is saturated, and bad; none
            %      'channel'     name or number, from 1, of the channel; 1
            %
            %   s.calibrate() without options: frames are electrons, as before the first call.
            %
            %   Example:
            %       s.calibrate('dark', mean(darks, 3), 'bad', std(darks, 0, 3) > 50, 'gain_e', 4)
            %       c = s.fit(raw);                      % uint16, as the camera delivered it
            %
            %   See also cophase.Session.fit.
            [channel, others] = self.channel_of(varargin);
            cophase_mex('session.calibrate', self.id, channel, others{:});
        end

        function sentences = warnings(self)
            %WARNINGS  What to know before using the numbers, a cell of sentences.
            %   sentences = s.warnings() has, for instance, the loss of the device that 'auto' chose, after which the
            %   CPU does the work (a device that was named fails with cophase:DEVICE instead), and channels that contradict
            %   each other in the last fit.
            %
            %   See also cophase.Session.fit, cophase.devices.
            sentences = cophase.Handle.lines(self.text('WARNINGS', 1, 1));
        end

        function [coefficients_nm, covariance_nm2, group] = refine(self, group)
            %REFINE  Coefficients with their covariance.
            %   [c, C] = s.refine(k) returns the coefficients, nm, of group k of the last fit, which is image k with one channel,
            %   and their covariance, nm^2; of the first by default. With one channel the covariance is that of the noise. Of
            %   several channels it is from the information at the fitted wavefront, with the whole wavelengths of pistons
            %   found: the estimate of a cophase.Estimator with the policy 'realtime'. It takes as long as some hundred
            %   evaluations of each channel.
            %
            %   [c, C, group] = s.refine(k) also returns a struct as fit does, without sigma_nm, with the smallest probability
            %   of the whole wavelengths in group.piston_probability.
            %
            %   Example:
            %       s.fit(frame);
            %       [c, C] = s.refine();
            %       errorbar(c, sqrt(diag(C)))
            %
            %   See also cophase.Session.fit, cophase.Sequence.estimate.
            if nargin < 2
                group = 1;
            end
            [coefficients_nm, covariance_nm2, group] = cophase_mex('session.refine', self.id, group);
        end

        function text = message(self, group, channel)
            %MESSAGE  Reason of the status of an image.
            %   text = s.message(k) returns a sentence on image k of the last fit; on the first by default.
            %   text = s.message(k, channel) is on the frame of group k in a channel, by its name or its number from 1.
            %
            %   Example:
            %       [c, report] = s.fit(frame);
            %       if ~strcmp(report.status, 'OK'), disp(s.message()), end
            %
            %   See also cophase.Session.fit.
            if nargin < 2
                group = 1;
            end
            if nargin < 3
                channel = 1;
            end
            text = self.text('IMAGE_MESSAGE', group, cophase.Handle.channel_number(self.channels, channel));
        end

        function [objectives, gradients] = evaluate(self, coefficients_nm, frames, varargin)
            %EVALUATE  Objective and gradient, for an optimizer of the caller's.
            %   f = s.evaluate(c, frames) returns, in a row, the objective of each image at its column of c, m.modes x
            %   count, double: the function that fit minimizes. Without frames, or with [], they are those of the last
            %   evaluation, if no fit came since.
            %
            %   [f, g] = s.evaluate(c, frames) also returns the gradients, per nm, in columns.
            %
            %   [...] = s.evaluate(c, frames, Name, Value, ...) chooses:
            %      'read_noise_e'  read noise of a pixel, electrons RMS, 0 for none; the scene's
            %      'channel'       name or number, from 1, of the channel of the frames; 1
            %
            %   Example:
            %       s.evaluate(zeros(m.modes, 1), frame);
            %       options = optimoptions('fminunc', 'SpecifyObjectiveGradient', true);
            %       c = fminunc(@(c) s.evaluate(c), zeros(m.modes, 1), options);
            %
            %   See also cophase.Session.fit.
            if nargin < 3
                frames = [];
            end
            [channel, others] = self.channel_of(varargin);
            results = cell(1, max(nargout, 1));
            [results{:}] = cophase_mex('session.evaluate', self.id, channel, coefficients_nm, frames, others{:});
            objectives = results{1};
            if nargout > 1
                gradients = results{2};
            end
        end
    end

    methods (Access = private)
        function text = text(self, what, group, channel)
            text = cophase_mex('session.text', self.id, what, group, channel);
        end

        function frames = by_channel(self, frames)
            % The frames of each channel in a cell, in order.
            if isstruct(frames)
                if ~isempty(setxor(fieldnames(frames), self.channels))
                    error('cophase:BAD_SHAPE', 'frames has the channels %s: those of the model, %s, are accepted', ...
                        strjoin(fieldnames(frames)', ', '), strjoin(self.channels', ', '));
                end
                frames = cellfun(@(name) frames.(name), self.channels, 'UniformOutput', false);
            elseif numel(self.channels) == 1
                frames = {frames};
            elseif ~iscell(frames) || isempty(frames)
                error('cophase:BAD_SHAPE', 'frames is a %s: a struct or a cell with the frames of each channel is accepted', ...
                    class(frames));
            end
        end

        function [channel, others] = channel_of(self, options)
            % Number of the channel that the option 'channel' names, 1 by default, and the other options.
            channel = 1;
            at = 2 * find(strcmpi(options(1:2:end - 1), 'channel'), 1) - 1;
            if ~isempty(at)
                channel = cophase.Handle.channel_number(self.channels, options{at + 1});
                options(at:at + 1) = [];
            end
            others = options;
        end
    end
end
