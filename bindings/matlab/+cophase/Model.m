classdef Model < cophase.Handle
    %MODEL  A telescope and its camera, as an estimate sees them.
    %   m = cophase.Model(scene_text) builds the model that a scene (TOML) describes: pupil, modes, diversity, detector.
    %   This takes about a second at the size of Keck. Share it between as many sessions as you like.
    %
    %   m = cophase.Model(scene_text, directory) looks for the files that the scene names in a directory, and not in the
    %   working directory.
    %
    %   m = cophase.Model(scene_text, directory, Name, Value, ...) puts arrays in the place of what the scene says:
    %      'Pupil'         n x n amplitude, 0 to 1, over the scene's pupil.grid_m; n is even. It is needed with the
    %                      others.
    %      'Segments'      n x n labels 0, 1, ... of the segment that a sample belongs to; negative where none is
    %      'Modes'         n x n x K wavefronts, nm for each nm of their coefficient: those of unit RMS over the pupil
    %                      make coefficients nm RMS
    %      'Diversity_nm'  n x n wavefront, nm
    %
    %   m = cophase.Model.fromArrays(pupil, modes, Name, Value, ...) needs no scene.
    %
    %   Maps are (y, x): rows go with y, columns with x. Coefficients and wavefronts are nm of optical path difference.
    %   The beginning of an option's name is enough, whatever its case: 'diversity'. Failures raise cophase:<STATUS>,
    %   such as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %       c = zeros(m.Modes, 1);
    %       c(1) = 100;                       % nm of piston of the first segment
    %       imagesc(m.psf(c)), axis image
    %
    %   See also cophase.Model.fromArrays, cophase.Model.wavefront, cophase.Model.psf, cophase.Session, cophase.preset.

    properties (SetAccess = private)
        Modes        % how many coefficients there are
        SegmentModes % how many of them, the first ones, are of the segments
        Names        % of the modes, a cell column of text
        FrameSize    % [rows columns] of a frame of the detector
        Samples      % rows, and columns, of wavefront maps
        Pixels       % rows, and columns, of a PSF: the part of a frame that is fitted
    end

    methods
        function self = Model(scene_text, directory, varargin)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene_text is missing: the text of a scene is accepted');
            end
            if nargin < 2
                directory = '';
            end
            self.create('model', scene_text, directory, varargin{:});
            self.Modes = cophase_mex('model.modes', self.id);
            self.SegmentModes = cophase_mex('model.segment_modes', self.id);
            self.Names = cophase_mex('model.names', self.id);
            self.FrameSize = cophase_mex('model.frame_size', self.id);
            self.Samples = cophase_mex('model.samples', self.id);
            self.Pixels = cophase_mex('model.pixels', self.id);
        end

        function [phasing_nm, ncpa_nm] = wavefront(self, coefficients_nm)
            %WAVEFRONT  The wavefront of some coefficients.
            %   [phasing_nm, ncpa_nm] = m.wavefront(c) returns two maps (y, x) of m.Samples rows and columns: the
            %   errors of the segments, and the non-common path aberrations. They are NaN outside the pupil. c has
            %   m.Modes elements, nm.
            %
            %   Example:
            %       [phasing_nm, ncpa_nm] = m.wavefront(c);
            %       imagesc(phasing_nm), axis image, colorbar
            %
            %   See also cophase.Model.psf, cophase.Session.fit.
            maps_nm = cophase_mex('model.wavefront', self.id, coefficients_nm);
            phasing_nm = maps_nm(:, :, 1);
            ncpa_nm = maps_nm(:, :, 2);
        end

        function image = psf(self, coefficients_nm)
            %PSF  The image of a point, with the diversity.
            %   image = m.psf(c) returns the PSF of coefficients of m.Modes elements, nm, on m.Pixels rows and columns.
            %   Over an unbounded detector it sums to 1.
            %
            %   Example:
            %       imagesc(m.psf(zeros(m.Modes, 1))), axis image
            %
            %   See also cophase.Model.wavefront.
            image = cophase_mex('model.psf', self.id, coefficients_nm);
        end
    end

    methods (Static)
        function self = fromArrays(pupil, modes, varargin)
            %FROMARRAYS  A model from a pupil and a matrix of modes, as OOMAO keeps them.
            %   m = cophase.Model.fromArrays(pupil, modes, Name, Value, ...) builds a model without a scene.
            %
            %   pupil is n x n, amplitude 0 to 1 or logical, n even. modes holds wavefronts: n x n x K, or as a matrix
            %   with a column for each mode and a row for each sample of the grid, in the order of pupil(:), or for
            %   each sample with light, in that of find(pupil). So the modes of an OOMAO zernike or deformable mirror
            %   go in as they are, sparse ones too; [] is none. A coefficient is nm of such a mode: nm RMS if that has
            %   unit RMS.
            %
            %   What the camera sees:
            %      'Wavelength_nm'          required
            %      'FrameSize'              pixels of a frame, n or [rows columns]; required
            %      'SamplesPerLambdaOverD'  pixels per lambda over the width of the pupil array; 2
            %      'DiversityFocus_waves'   focus that defocuses the images, waves RMS; 1.5
            %      'Diversity_nm'           n x n map of the diversity in place of a focus, nm
            %      'ReadNoise_e'            read noise of a pixel, electrons RMS; 0
            %
            %   What the segments are:
            %      'Segments'               n x n labels 0, 1, ... of the segments, negative where none is
            %      'SegmentModes'           'piston', 'piston-tip-tilt' or 'none'; 'piston' if there are segments
            %
            %   Example:
            %       zern = zernike(4:15, 8, 'resolution', 64);              % OOMAO
            %       m = cophase.Model.fromArrays(zern.pupil, zern.modes, 'Wavelength_nm', 2200, 'FrameSize', 128);
            %       s = cophase.Session(m);
            %       c = s.fit(frame);                                       % nm of each Zernike
            %
            %   See also cophase.Model, cophase.Session.
            names = {'Wavelength_nm', 'FrameSize', 'SamplesPerLambdaOverD', 'DiversityFocus_waves', 'ReadNoise_e', ...
                'SegmentModes', 'Segments', 'Diversity_nm'};
            places = cophase_mex('options', names, varargin{:});
            given = cell(size(names));
            given(places > 0) = varargin(places(places > 0));
            scene_text = cophase.Model.scene(size(pupil, 1), given{1:6});
            self = cophase.Model(scene_text, '', 'Pupil', pupil, 'Modes', cophase.Model.stack(modes, pupil), ...
                'Segments', given{7}, 'Diversity_nm', given{8});
        end
    end

    methods (Static, Hidden)
        function maps = stack(modes, pupil)
            % Modes as n x n x K, whichever way they came; another shape goes on to be refused.
            n = size(pupil, 1);
            maps = full(modes);
            if ndims(maps) > 2 || isequal(size(maps), size(pupil)) || isempty(maps)
                return
            elseif size(maps, 1) == numel(pupil)
                maps = reshape(maps, n, [], size(maps, 2));
            elseif size(maps, 1) == nnz(pupil)
                scattered = zeros(numel(pupil), size(maps, 2), class(maps));
                scattered(find(pupil), :) = maps;
                maps = reshape(scattered, n, [], size(maps, 2));
            else
                error('cophase:BAD_SHAPE', ...
                    'modes has %d rows: %d, the samples of the pupil, or %d, those with light, is accepted', ...
                    size(maps, 1), numel(pupil), nnz(pupil));
            end
        end

        function text = scene(samples, wavelength_nm, frame_size, sampling, focus_waves, read_noise_e, segment_modes)
            % What the options of fromArrays say, as a scene.
            text = sprintf('[pupil]\nsamples = %d\n[image]\n', samples);
            % A frame that is not square is the middle of one that is.
            text = [text, cophase.Model.line('pixels', max(frame_size))];
            if numel(frame_size) == 2 && frame_size(1) ~= frame_size(2)
                text = [text, cophase.Model.line('rows', frame_size(1)), ...
                    cophase.Model.line('columns', frame_size(2))];
            end
            text = [text, cophase.Model.line('wavelength_nm', wavelength_nm), ...
                cophase.Model.line('samples_per_lambda_over_d', sampling), ...
                cophase.Model.line('diversity_focus_waves_rms', focus_waves), ...
                cophase.Model.line('read_noise_e', read_noise_e), ...
                sprintf('[modes]\n'), cophase.Model.line('segment', segment_modes)];
        end

        function text = line(key, value)
            % A line of a scene; none without a value.
            if isempty(value)
                text = '';
            elseif isnumeric(value)
                text = sprintf('%s = %s\n', key, num2str(double(value), 17));
            else
                text = sprintf('%s = "%s"\n', key, char(value));
            end
        end
    end
end
