classdef Model < cophase.Handle
    %MODEL  Model of the images of a wavefront: telescope, modes, and of each channel diversity and camera.
    %   m = cophase.Model(scene) builds the model of a scene: a TOML file, the name of a preset (cophase.preset), or TOML
    %   text. This takes about half a second for each channel at the size of Keck. Any number of sessions can use it.
    %
    %   m = cophase.Model(scene, directory) has the directory of the files that the scene names; that of the scene's file,
    %   or else the working directory, by default.
    %
    %   m = cophase.Model(scene, directory, Name, Value, ...) takes arrays instead of the scene's telescope:
    %      'pupil'         n x n amplitude, 0 to 1, over the scene's pupil.grid_m; n is even. Required with the others. One of
    %                      at least twice pupil.samples is averaged onto that grid, which the modes then have.
    %      'segments'      n x n labels of each sample's segment, from 0 or 1; negative, or 0 where they begin at 1,
    %                      outside all segments
    %      'modes'         n x n x K wavefronts, nm per nm of their coefficient: with unit RMS over the pupil,
    %                      coefficients are nm RMS. Zernike polynomials to Noll 21 follow them, unless
    %                      modes.exact_zernikes says otherwise.
    %      'diversity_nm'  n x n wavefront, nm
    %
    %   m = cophase.Model.from_arrays(pupil, modes, Name, Value, ...) needs no scene.
    %
    %   Maps are (y, x): rows are y, columns are x. Coefficients and wavefronts are nm of optical path difference. The
    %   beginning of an option's name is enough, in upper or lower case: 'diversity'. Failures raise cophase:<STATUS>, such
    %   as cophase:BAD_SCENE, with one sentence.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %       c = zeros(m.modes, 1);
    %       c(1) = 100;                       % nm of piston of the first segment
    %       imagesc(m.psf(c)), axis image
    %
    %   See also cophase.Model.from_arrays, cophase.Model.wavefront_nm, cophase.Model.psf, cophase.Model.channel,
    %   cophase.Session, cophase.preset.

    properties (SetAccess = private)
        modes         % number of modes, which is the number of coefficients of an image
        segment_modes % number of modes that move segments; they come first, the others are NCPA modes
        mode_names    % names of the modes, a cell column of text
        channels      % names of the channels, a cell column, in the order of the scene; one empty name if it lists none
        frame_shape   % [rows columns] of a frame; of several channels, those of the first
        samples       % rows, and columns, of a wavefront map
        pixels        % rows, and columns, of a PSF: the pixels that are compared; of several channels, those of the first
    end

    methods
        function self = Model(scene, directory, varargin)
            if nargin < 1
                error('cophase:BAD_ARGUMENT', 'scene is missing: a file, a preset or the text of a scene is accepted');
            end
            if isa(scene, 'cophase.Model')
                % The model of one of its channels, whose number stands in the place of the directory: see channel.
                self.create('model.channel', cophase.Handle.number(scene), directory);
            else
                [text, folder] = cophase.Handle.read_scene(scene);
                if nargin < 2 || isempty(directory)
                    directory = folder;
                end
                self.create('model.create', text, directory, varargin{:});
            end
            info = cophase_mex('model.info', self.id);
            self.modes = info.modes;
            self.segment_modes = info.segment_modes;
            self.mode_names = cophase_mex('model.names', self.id);
            self.channels = cophase_mex('model.channels', self.id);
            self.frame_shape = [info.rows, info.cols];
            self.samples = info.samples;
            self.pixels = info.pixels;
        end

        function model = channel(self, channel)
            %CHANNEL  Model of one of the channels.
            %   model = m.channel(channel) has the size of its frames and its PSF; channel is a name or a number from 1. All
            %   channels have the same modes.
            %
            %   Example:
            %       m = cophase.Model(cophase.preset('keck-pair'));
            %       imagesc(m.channel('minus').psf(zeros(m.modes, 1))), axis image
            %
            %   See also cophase.Model.psf, cophase.Session.fit.
            model = cophase.Model(self, cophase.Handle.channel_number(self.channels, channel));
        end

        function [phasing_nm, ncpa_nm] = wavefront_nm(self, coefficients_nm)
            %WAVEFRONT_NM  Wavefront of some coefficients.
            %   [phasing_nm, ncpa_nm] = m.wavefront_nm(c) returns two maps (y, x) of m.samples rows and columns, nm: the
            %   segments, and the non-common path aberrations; NaN outside the pupil. c has m.modes elements, nm.
            %
            %   Example:
            %       [phasing_nm, ncpa_nm] = m.wavefront_nm(c);
            %       imagesc(phasing_nm), axis image, colorbar
            %
            %   See also cophase.Model.psf, cophase.Session.fit.
            values = cophase_mex('model.wavefront_nm', self.id, coefficients_nm);
            maps_nm = cophase.Handle.maps(values, self.samples, self.samples);
            phasing_nm = maps_nm(:, :, 1);
            ncpa_nm = maps_nm(:, :, 2);
        end

        function image = psf(self, coefficients_nm)
            %PSF  PSF of some coefficients, with the diversity.
            %   image = m.psf(c) returns the PSF of coefficients of m.modes elements, nm, on m.pixels rows and columns.
            %   Its sum over an unbounded detector would be 1. Of several channels, m.channel gives the model of one.
            %
            %   Example:
            %       imagesc(m.psf(zeros(m.modes, 1))), axis image
            %
            %   See also cophase.Model.wavefront_nm.
            image = cophase.Handle.maps(cophase_mex('model.psf', self.id, coefficients_nm), self.pixels, self.pixels);
        end
    end

    methods (Static)
        function self = from_arrays(pupil, modes, varargin)
            %FROM_ARRAYS  A model from a pupil and a matrix of modes, as OOMAO keeps them.
            %   m = cophase.Model.from_arrays(pupil, modes, Name, Value, ...) builds a model without a scene.
            %
            %   pupil is n x n, amplitude 0 to 1 or logical, n even. modes holds wavefronts: n x n x K, or a matrix with
            %   a column for each mode, and a row for each sample of the grid, in the order of pupil(:), or for each
            %   illuminated sample, in the order of find(pupil). So it takes the modes of an OOMAO zernike or deformable
            %   mirror, also sparse ones; [] is none. A coefficient is nm of such a mode: nm RMS if that has unit RMS.
            %
            %   The camera:
            %      'wavelength_nm'              required
            %      'frame_shape'                pixels of a frame, n or [rows columns]; required
            %      'samples_per_lambda_over_d'  pixels per lambda over the width of the pupil array; 2
            %      'diversity_focus_waves_rms'  focus of the images, waves RMS; 1.5
            %      'diversity_nm'               n x n map of the diversity instead of a focus, nm
            %      'read_noise_e'               read noise of a pixel, electrons RMS, 0 for none; the scatter
            %                                   of the frame's border
            %
            %   The segments:
            %      'segments'                   n x n indices 0, 1, ... of the segments; negative outside all segments
            %      'segment_modes'              'piston', 'piston-tip-tilt' or 'none'; 'piston' if there are segments
            %
            %   The modes beside yours:
            %      'ncpa'                       without modes: 'kl' (the default), 'zernike' or 'none'
            %      'grid_m'                     width of the pupil array, m, which 'kl' needs
            %      'exact_zernikes'             [first last] Noll index of Zernike polynomials that are estimated too; none
            %                                   with modes, [2 21] without
            %
            %   Example:
            %       zern = zernike(4:15, 8, 'resolution', 64);              % OOMAO
            %       m = cophase.Model.from_arrays(zern.pupil, zern.modes, 'wavelength_nm', 2200, 'frame_shape', 128);
            %       s = cophase.Session(m);
            %       c = s.fit(frame);                                       % nm of each Zernike
            %
            %   See also cophase.Model, cophase.Session.
            names = {'wavelength_nm', 'frame_shape', 'samples_per_lambda_over_d', 'diversity_focus_waves_rms', ...
                'read_noise_e', 'segment_modes', 'ncpa', 'grid_m', 'exact_zernikes', 'segments', 'diversity_nm'};
            places = cophase.Handle.call('options', names, varargin{:});
            given = cell(size(names));
            given(places > 0) = varargin(places(places > 0));
            if isempty(given{9}) && ~isempty(modes)
                given{9} = 'none';
            end
            scene_text = cophase.Model.scene(size(pupil, 1), given{1:9});
            self = cophase.Model(scene_text, '', 'pupil', pupil, 'modes', cophase.Model.stack(modes, pupil), ...
                'segments', given{10}, 'diversity_nm', given{11});
        end
    end

    methods (Static, Hidden)
        function maps = stack(modes, pupil)
            % Modes as n x n x K. The library refuses arrays of other shapes.
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
                    'modes has %d rows: %d, the samples of the pupil, or %d, the illuminated ones, is accepted', ...
                    size(maps, 1), numel(pupil), nnz(pupil));
            end
        end

        function text = scene(samples, wavelength_nm, frame_shape, sampling, focus_waves, read_noise_e, ...
                segment_modes, ncpa, grid_m, exact_zernikes)
            % Scene of the options of from_arrays.
            text = [sprintf('[pupil]\nsamples = %d\n', samples), cophase.Model.line('grid_m', grid_m), ...
                sprintf('[image]\n')];
            % The rows and columns of a frame that is not square are cut from a square.
            text = [text, cophase.Model.line('pixels', max(frame_shape))];
            if numel(frame_shape) == 2 && frame_shape(1) ~= frame_shape(2)
                text = [text, cophase.Model.line('rows', frame_shape(1)), ...
                    cophase.Model.line('columns', frame_shape(2))];
            end
            text = [text, cophase.Model.line('wavelength_nm', wavelength_nm), ...
                cophase.Model.line('samples_per_lambda_over_d', sampling), ...
                cophase.Model.line('diversity_focus_waves_rms', focus_waves), ...
                cophase.Model.line('read_noise_e', read_noise_e), ...
                sprintf('[modes]\n'), cophase.Model.line('segment', segment_modes), cophase.Model.line('ncpa', ncpa), ...
                cophase.Model.line('exact_zernikes', exact_zernikes)];
        end

        function text = line(key, value)
            % A line of a scene; empty without a value.
            if isempty(value)
                text = '';
            elseif isnumeric(value) && numel(value) == 2
                text = sprintf('%s = [%d, %d]\n', key, value);
            elseif isnumeric(value)
                text = sprintf('%s = %s\n', key, num2str(double(value), 17));
            else
                text = sprintf('%s = "%s"\n', key, char(value));
            end
        end
    end
end
