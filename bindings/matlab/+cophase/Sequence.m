classdef Sequence < cophase.Handle
    %SEQUENCE  The last images that sessions of a model fitted, and their running estimate.
    %   q = cophase.Sequence(model, capacity) keeps the last `capacity` images, and combines their fits.
    %
    %   Methods:
    %      push           adds the images of a session's last fit
    %      estimate       the estimate so far, with its error bars
    %      images_needed  number of further images for an accuracy
    %      clear          drops all images
    %
    %   Failures raise cophase:<STATUS>, such as cophase:BAD_VALUE, with one sentence.
    %
    %   Example:
    %       q = cophase.Sequence(m, 200);
    %       for k = 1:size(frames, 3)
    %           s.fit(frames(:, :, k));
    %           q.push(s)
    %       end
    %       e = q.estimate();
    %       fprintf('%.1f +- %.1f nm of phasing\n', e.info.phasing_rms_nm, e.info.phasing_sigma_nm)
    %
    %   See also cophase.Sequence.estimate, cophase.Sequence.images_needed, cophase.Session, cophase.Model.

    properties (SetAccess = private)
        capacity % number of images that are kept; the oldest are dropped beyond it
    end

    methods
        function self = Sequence(model, capacity)
            if nargin < 2
                error('cophase:BAD_ARGUMENT', 'a model and a capacity are accepted: cophase.Sequence(model, 200)');
            end
            self.create('sequence.create', cophase.Handle.number(model), capacity);
            self.capacity = capacity;
        end

        function push(self, session)
            %PUSH  Adds all images of a session's last fit, of any status.
            %   q.push(s), where s is a session of the same model.
            %
            %   See also cophase.Session.fit, cophase.Sequence.estimate.
            cophase_mex('sequence.push', self.id, cophase.Handle.number(session));
        end

        function result = estimate(self)
            %ESTIMATE  Estimate so far: mean, clipped mean or median of the images as the scene says.
            %   e = q.estimate() returns a struct with the fields
            %      coefficients_nm  a column, nm, for cophase.Model.wavefront_nm
            %      sigma_nm         standard deviation of each coefficient, a column, nm
            %      covariance_nm2   covariance of the coefficients, nm^2
            %      info             a struct: images, used, clipped (left out as outliers); phasing_rms_nm and its error
            %                       bar phasing_sigma_nm, ncpa_rms_nm and its ncpa_sigma_nm (RMS over the pupil);
            %                       reduced_chi2, the median of the images used
            %
            %   From eight images on, outliers are found by comparing images, and error bars are from the scatter
            %   between them.
            %
            %   Example:
            %       e = q.estimate();
            %       [phasing_nm, ncpa_nm] = m.wavefront_nm(e.coefficients_nm);
            %
            %   See also cophase.Sequence.images_needed.
            result = cophase_mex('sequence.estimate', self.id);
        end

        function images = images_needed(self, phasing_nm, ncpa_nm)
            %IMAGES_NEEDED  Number of further images for an accuracy.
            %   n = q.images_needed(phasing_nm, ncpa_nm) returns the number of further images like those so far that
            %   bring both error bars, nm RMS over the pupil, down to these; 0 if they are. Inf asks nothing.
            %
            %   Example:
            %       n = q.images_needed(10, Inf);
            %
            %   See also cophase.Sequence.estimate.
            if nargin < 3
                ncpa_nm = Inf;
            end
            images = cophase_mex('sequence.images_needed', self.id, phasing_nm, ncpa_nm);
        end

        function clear(self)
            %CLEAR  Drops all images.
            %   q.clear()
            %
            %   See also cophase.Sequence.push.
            cophase_mex('sequence.clear', self.id);
        end
    end
end
