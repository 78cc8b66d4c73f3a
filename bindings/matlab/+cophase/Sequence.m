classdef Sequence < cophase.Handle
    %SEQUENCE  The static aberrations under a sequence of images, as they come.
    %   q = cophase.Sequence(model, capacity) keeps the last `capacity` images, and combines what their fits found: each
    %   image has its own turbulence, and what they share is what is sought.
    %
    %   Methods:
    %      push          takes the images of a session's last fit
    %      estimate      the estimate so far, with its error bars
    %      covariance    of its coefficients
    %      imagesNeeded  how many more images an accuracy asks for
    %      clear         forgets all images
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
    %       fprintf('%.1f +- %.1f nm of phasing\n', e.PhasingRms_nm, e.PhasingSigma_nm)
    %
    %   See also cophase.Sequence.estimate, cophase.Sequence.imagesNeeded, cophase.Session, cophase.Model.

    properties (SetAccess = private)
        Capacity % most images that it keeps
    end

    methods
        function self = Sequence(model, capacity)
            if nargin < 2
                error('cophase:BAD_ARGUMENT', 'a model and a capacity are accepted: cophase.Sequence(model, 200)');
            end
            self.create('sequence', cophase.Handle.of(model), capacity);
            self.Capacity = capacity;
        end

        function push(self, session)
            %PUSH  Takes the images of a session's last fit; if there is no room, the oldest go.
            %   q.push(s), where s is a session of the same model.
            %
            %   See also cophase.Session.fit, cophase.Sequence.estimate.
            cophase_mex('sequence.push', self.id, cophase.Handle.of(session));
        end

        function result = estimate(self)
            %ESTIMATE  The estimate so far.
            %   e = q.estimate() returns a struct with the fields
            %      Coefficients_nm  a column, nm, for cophase.Model.wavefront
            %      Sigma_nm         their error bars, 1 sigma
            %      Images           how many images are kept; Used: combined; Clipped: left out as outliers
            %      PhasingRms_nm    RMS over the pupil of the segments' errors; PhasingSigma_nm: of their error bar
            %      NcpaRms_nm       RMS over the pupil of the NCPA; NcpaSigma_nm: of their error bar
            %      ReducedChi2      median of the images used
            %
            %   Example:
            %       e = q.estimate();
            %       [phasing_nm, ncpa_nm] = m.wavefront(e.Coefficients_nm);
            %
            %   See also cophase.Sequence.covariance, cophase.Sequence.imagesNeeded.
            result = cophase_mex('sequence.estimate', self.id);
        end

        function covariance_nm2 = covariance(self)
            %COVARIANCE  Of the estimate's coefficients.
            %   C = q.covariance() returns m.Modes x m.Modes, nm^2.
            %
            %   See also cophase.Sequence.estimate, cophase.Session.covariance.
            covariance_nm2 = cophase_mex('sequence.covariance', self.id);
        end

        function images = imagesNeeded(self, phasing_nm, ncpa_nm)
            %IMAGESNEEDED  How many more images an accuracy asks for.
            %   n = q.imagesNeeded(phasing_nm, ncpa_nm) returns the number of further images until both error bars, RMS
            %   over the pupil, are at most these. Inf asks nothing of one.
            %
            %   Example:
            %       n = q.imagesNeeded(10, Inf);
            %
            %   See also cophase.Sequence.estimate.
            if nargin < 3
                ncpa_nm = Inf;
            end
            images = cophase_mex('sequence.images_needed', self.id, phasing_nm, ncpa_nm);
        end

        function clear(self)
            %CLEAR  Forgets all images.
            %   q.clear()
            %
            %   See also cophase.Sequence.push.
            cophase_mex('sequence.clear', self.id);
        end
    end
end
