classdef Session < cophase.Handle
    %SESSION  Fits of single images with a model, in memory that is allocated when the session is created.
    %   s = cophase.Session(model) follows the policy 'realtime': no modes with a prior, no outlier rejection, no restarts;
    %   cophase.Estimator is the full pipeline. The model may be deleted afterwards.
    %
    %   s = cophase.Session(model, Name, Value, ...) chooses:
    %      'capacity'           largest number of images of a call; 1
    %      'precision'          'f64' or 'f32' of the computation, for frames of any class; the scene's
    %      'device'             'cpu', 'auto', 'opencl' or a name of cophase.devices; the scene's
    %      'threads'            threads of the CPU: 1 for the caller's own, -1 for one per processor; 1
    %      'max_evaluations'    largest number of evaluations for one image; the scene's
    %      'step_tolerance_nm'  a fit stops where neither a coefficient nor the RMS of the wavefront would change by
    %                           more than this; the scene's
    %   The beginning of a name is enough, in upper or lower case.
    %
    %   Methods:
    %      fit             coefficients of images, and a report on each
    %      calibrate       calibration of the frames
    %      covariance_nm2  covariance of the coefficients of an image
    %      message         reason of the status of an image
    %      warnings        what to know before using the numbers
    %      evaluate        objective and gradient, for an optimizer of the caller's
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SHAPE, with one sentence.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %       s = cophase.Session(m, 'capacity', 8);
    %       [c, report] = s.fit(frames);                 % rows x columns x 8, electrons
    %       [phasing_nm, ncpa_nm] = m.wavefront_nm(c(:, 1));
    %
    %   See also cophase.Session.fit, cophase.Session.calibrate, cophase.Model, cophase.Sequence, cophase.devices.

    properties (SetAccess = private)
        model  % model that is fitted
        device % device that the session runs on
        policy % its policy
    end

    methods
        function self = Session(model, varargin)
            if nargin < 1
                model = [];
            end
            self.create('session.create', cophase.Handle.number(model), varargin{:});
            self.model = model;
            self.device = self.text('DEVICE', 1);
            self.policy = self.text('POLICY', 1);
        end

        function [coefficients_nm, report] = fit(self, frames, varargin)
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
            %   and is_used, is_clipped, which are 0 in a session.
            %
            %   [...] = s.fit(frames, Name, Value, ...) chooses:
            %      'deadline_s'    time for the whole call, s; none
            %      'read_noise_e'  read noise of a pixel, electrons RMS, 0 for none; the scene's
            %      'start_nm'      starts of the fits, m.modes x count; zeros
            %
            %   Ctrl-C stops it, with cophase:INTERRUPTED, and the session can be used again. In MATLAB for Windows it
            %   does not: give a deadline.
            %
            %   Example:
            %       [c, report] = s.fit(frames, 'deadline_s', 0.5);
            %       bad = find(~strcmp({report.status}, 'OK'));
            %       for k = bad, disp(s.message(k)), end
            %
            %   See also cophase.Session.message, cophase.Session.covariance_nm2, cophase.Session.calibrate,
            %   cophase.Sequence.
            results = cell(1, max(nargout, 1));
            [results{:}] = cophase_mex('session.fit', self.id, frames, varargin{:});
            coefficients_nm = results{1};
            if nargout > 1
                report = results{2};
            end
        end

        function calibrate(self, varargin)
            %CALIBRATE  Sets the calibration of the frames of later calls.
            %   s.calibrate(Name, Value, ...) makes electrons = (raw - dark) * gain / flat:
            %      'dark'        rows x columns, raw units; none
            %      'flat'        rows x columns, about 1; none
            %      'bad'         rows x columns, logical or numeric: bad pixels, which take no part, are not 0; none
            %      'gain_e'      electrons per raw unit; image.gain_e_per_adu of the scene, or 1
            %      'saturation'  raw value from which on a pixel is saturated, and bad; none
            %
            %   s.calibrate() without options: frames are electrons, as before the first call.
            %
            %   Example:
            %       s.calibrate('dark', mean(darks, 3), 'bad', std(darks, 0, 3) > 50, 'gain_e', 4)
            %       c = s.fit(raw);                      % uint16, as the camera delivered it
            %
            %   See also cophase.Session.fit.
            cophase_mex('session.calibrate', self.id, varargin{:});
        end

        function sentences = warnings(self)
            %WARNINGS  What to know before using the numbers, a cell of sentences.
            %   sentences = s.warnings() has, for instance, the loss of the device that 'auto' chose, after which the
            %   CPU does the work. A device that was named fails with cophase:DEVICE instead.
            %
            %   See also cophase.Session.fit, cophase.devices.
            sentences = cophase.Handle.lines(self.text('WARNINGS', 1));
        end

        function covariance_nm2 = covariance_nm2(self, image)
            %COVARIANCE_NM2  Covariance of the coefficients of an image.
            %   C = s.covariance_nm2(k) returns the covariance, m.modes x m.modes, nm^2, of image k of the last fit; of
            %   the first by default.
            %
            %   Example:
            %       c = s.fit(frame);
            %       errorbar(c, sqrt(diag(s.covariance_nm2())))
            %
            %   See also cophase.Session.fit, cophase.Sequence.estimate.
            if nargin < 2
                image = 1;
            end
            covariance_nm2 = cophase_mex('session.covariance_nm2', self.id, image);
        end

        function text = message(self, image)
            %MESSAGE  Reason of the status of an image.
            %   text = s.message(k) returns a sentence on image k of the last fit; on the first by default.
            %
            %   Example:
            %       [c, report] = s.fit(frame);
            %       if ~strcmp(report.status, 'OK'), disp(s.message()), end
            %
            %   See also cophase.Session.fit.
            if nargin < 2
                image = 1;
            end
            text = self.text('IMAGE_MESSAGE', image);
        end

        function [objectives, gradients] = evaluate(self, coefficients_nm, frames, varargin)
            %EVALUATE  Objective and gradient, for an optimizer of the caller's.
            %   f = s.evaluate(c, frames) returns, in a row, the objective of each image at its column of c, m.modes x
            %   count, double: the function that fit minimizes. Without frames, or with [], they are those of the last
            %   evaluation, if no fit came since.
            %
            %   [f, g] = s.evaluate(c, frames) also returns the gradients, per nm, in columns.
            %
            %   [...] = s.evaluate(c, frames, 'read_noise_e', value) has another read noise than the scene's.
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
            if nargout > 1
                [objectives, gradients] = ...
                    cophase_mex('session.evaluate', self.id, coefficients_nm, frames, varargin{:});
            else
                objectives = cophase_mex('session.evaluate', self.id, coefficients_nm, frames, varargin{:});
            end
        end
    end

    methods (Access = private)
        function text = text(self, what, index)
            text = cophase_mex('session.text', self.id, what, index);
        end
    end
end
