classdef Session < cophase.Handle
    %SESSION  A workspace that fits images.
    %   s = cophase.Session(model) prepares fits of one image at a time on the processor. Whatever is costly happens
    %   here, once. The model may be deleted afterwards.
    %
    %   s = cophase.Session(model, Name, Value, ...) chooses:
    %      'Capacity'          most images of a call; 1
    %      'Precision'         'double' or 'single': of the computation, whatever the class of the frames; 'double'
    %      'Device'            'cpu', 'auto', 'opencl' or an address that cophase.devices lists; 'cpu'
    %      'Threads'           of the processor: 1, or 0 for all that there are; 1
    %      'MaxEvaluations'    most evaluations of the model for an image; what the scene says
    %      'StepTolerance_nm'  a fit ends where neither a coefficient nor the wavefront's RMS would
    %                          move by more; what the scene says
    %   The beginning of a name is enough, whatever its case.
    %
    %   Methods:
    %      fit         coefficients of images, and a report on each
    %      calibrate   what the camera's raw values mean
    %      covariance  error bars of an image that was fitted
    %      message     why an image has its status
    %      load        images for evaluate
    %      evaluate    objective and gradient, for an optimizer of your own
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_SHAPE, with one sentence.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %       s = cophase.Session(m, 'Capacity', 8);
    %       [c, report] = s.fit(frames);                 % rows x columns x 8, electrons
    %       [phasing_nm, ncpa_nm] = m.wavefront(c(:, 1));
    %
    %   See also cophase.Session.fit, cophase.Session.calibrate, cophase.Model, cophase.Sequence, cophase.devices.

    properties (SetAccess = private)
        Model  % of which images are fitted
        Device % where they are: an address that cophase.devices lists
    end

    methods
        function self = Session(model, varargin)
            if nargin < 1
                model = [];
            end
            device = self.create('session', cophase.Handle.of(model), varargin{:});
            self.Device = strtok(device, sprintf('\t'));
            self.Model = model;
        end

        function [coefficients_nm, report] = fit(self, frames, varargin)
            %FIT  Fits images.
            %   c = s.fit(frames) returns the coefficients, nm, of each image in a column: m.Modes x count, double.
            %   frames is rows x columns x count, m.FrameSize each, of class single, double, uint16, int32 or uint8;
            %   none is converted beforehand. Values are electrons, unless calibrate said what they mean. NaN masks a
            %   pixel.
            %
            %   [c, report] = s.fit(frames) also returns a struct for each image, with the fields
            %      Status        'OK'; 'MISFIT' if the residual is larger than the noise; 'WRONG_MINIMUM';
            %                    'NOT_CONVERGED'; 'UNUSABLE', with coefficients of NaN; 'DEADLINE', with the best so far
            %      BadPixels     how many took no part
            %      Evaluations   of the model
            %      ReducedChi2   of the residual
            %      Flux_e, Background_e, Tip_nm, Tilt_nm
            %      Seconds       it took
            %
            %   [...] = s.fit(frames, Name, Value, ...) chooses:
            %      'Deadline_s'   time for the whole call, s; none
            %      'ReadNoise_e'  of a pixel, electrons RMS; what the scene says
            %      'Start_nm'     where to begin, m.Modes x count; zeros
            %
            %   Ctrl-C stops it, with cophase:INTERRUPTED, and the session can be used again. In MATLAB for Windows it
            %   does not: give a deadline.
            %
            %   Example:
            %       [c, report] = s.fit(frames, 'Deadline_s', 0.5);
            %       bad = find(~strcmp({report.Status}, 'OK'));
            %       for k = bad, disp(s.message(k)), end
            %
            %   See also cophase.Session.message, cophase.Session.covariance, cophase.Session.calibrate,
            %   cophase.Sequence.
            results = cell(1, max(nargout, 1));
            [results{:}] = cophase_mex('session.fit', self.id, frames, varargin{:});
            coefficients_nm = results{1};
            if nargout > 1
                report = results{2};
            end
        end

        function calibrate(self, varargin)
            %CALIBRATE  Says what the camera's raw values mean.
            %   s.calibrate(Name, Value, ...) makes electrons = (raw - dark) * gain / flat of coming frames:
            %      'Dark'        rows x columns, raw units; none
            %      'Flat'        rows x columns, about 1; none
            %      'Bad'         rows x columns, logical or numeric: pixels that are not 0 take no part; none
            %      'Gain_e'      electrons per raw unit; 1
            %      'Saturation'  raw values of this or more take no part; Inf
            %
            %   s.calibrate() forgets it: values are electrons again.
            %
            %   Example:
            %       s.calibrate('Dark', mean(darks, 3), 'Bad', std(darks, 0, 3) > 50, 'Gain_e', 4)
            %       c = s.fit(raw);                      % uint16, as the camera delivered it
            %
            %   See also cophase.Session.fit.
            cophase_mex('session.calibrate', self.id, varargin{:});
        end

        function sentence = deviceFailure(self)
            %DEVICEFAILURE  Whether the device was lost.
            %   s.deviceFailure() says that the device which 'auto' chose was lost and the CPU has taken its place; empty
            %   where it was not. A device that was named fails with cophase:DEVICE instead.
            %
            %   See also cophase.Session.fit, cophase.devices.
            sentence = cophase_mex('session.device_failure', self.id);
        end

        function covariance_nm2 = covariance(self, image)
            %COVARIANCE  Of the coefficients of an image.
            %   C = s.covariance(k) returns the covariance, m.Modes x m.Modes, nm^2, of image k of the last fit; of the
            %   first, if k is left out.
            %
            %   Example:
            %       c = s.fit(frame);
            %       errorbar(c, sqrt(diag(s.covariance())))
            %
            %   See also cophase.Session.fit, cophase.Sequence.covariance.
            if nargin < 2
                image = 1;
            end
            covariance_nm2 = cophase_mex('session.covariance', self.id, image);
        end

        function text = message(self, image)
            %MESSAGE  Why an image has its status.
            %   text = s.message(k) returns a sentence on image k of the last fit; on the first, if k is left out.
            %
            %   Example:
            %       [c, report] = s.fit(frame);
            %       if ~strcmp(report.Status, 'OK'), disp(s.message()), end
            %
            %   See also cophase.Session.fit.
            if nargin < 2
                image = 1;
            end
            text = cophase_mex('session.message', self.id, image);
        end

        function load(self, frames, varargin)
            %LOAD  Images for evaluate.
            %   s.load(frames, Name, Value, ...) takes frames and options as fit does.
            %
            %   See also cophase.Session.evaluate, cophase.Session.fit.
            cophase_mex('session.load', self.id, frames, varargin{:});
        end

        function [objectives, gradients] = evaluate(self, coefficients_nm)
            %EVALUATE  Objective and gradient, for an optimizer of your own.
            %   f = s.evaluate(c) returns, in a row, the objective of each image that was loaded at its column of c,
            %   m.Modes x count, double. fit minimises the same.
            %
            %   [f, g] = s.evaluate(c) also returns the gradients, per nm, in columns.
            %
            %   Example:
            %       s.load(frame)
            %       options = optimoptions('fminunc', 'SpecifyObjectiveGradient', true);
            %       c = fminunc(@(c) s.evaluate(c), zeros(m.Modes, 1), options);
            %
            %   See also cophase.Session.load, cophase.Session.fit.
            if nargout > 1
                [objectives, gradients] = cophase_mex('session.evaluate', self.id, coefficients_nm);
            else
                objectives = cophase_mex('session.evaluate', self.id, coefficients_nm);
            end
        end
    end
end
