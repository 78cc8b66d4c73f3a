classdef Estimate < cophase.Handle
    %ESTIMATE  Estimate of the static wavefront: modes, maps, error bars, reports on the images.
    %   cophase.Estimator.estimate makes it. Maps are (y, x), double, nm, NaN outside the pupil.
    %
    %   Fields of the struct info:
    %      images, used, clipped          images; those that were combined; those left out as outliers
    %      modes, segment_modes, samples  sizes; modes that move segments come first
    %      error_terms, warnings          their numbers
    %      method, policy                 'modal' or 'map'; 'full' or 'realtime'
    %      status                         the worst of an image that counts for the whole
    %      is_sequence                    whether error bars are from the scatter between images
    %      iterations, has_settled        of a MAP estimate
    %      ao_knowledge                   of the adaptive optics: 'nothing', 'spectrum', 'loop', 'telemetry'
    %      precision, evaluations         'f64' or 'f32'; evaluations of objective and gradient
    %      phasing_rms_nm, ncpa_rms_nm, wavefront_rms_nm        RMS over the pupil, piston, tip and tilt removed
    %      phasing_sigma_nm, ncpa_sigma_nm, wavefront_sigma_nm  their expected errors; the last of a MAP estimate is an upper limit
    %      reduced_chi2                   median of the images used
    %      images_to_halve                further images that halve both error bars; NaN if unknown
    %      map_width_m, seconds, model_seconds
    %      telemetry_gain, telemetry_correlation                of the measured slopes with those of the retrieved
    %                                     wavefronts, about 1 where they belong together; NaN without telemetry
    %      channels, integers             numbers of channels and of segments in integers
    %      model_errors                   their number
    %      has_maps_without_staircases    1 if without_staircases is there, else 0
    %
    %   Methods:
    %      report   text, as the program prints it
    %      write    writes a FITS file
    %      correct  what to add to segments, mirror and reference slopes
    %
    %   Example:
    %       e = cophase.Estimator(scene).estimate(frames);
    %       errorbar(e.coefficients_nm, e.sigma_nm)
    %
    %   See also cophase.Estimator, cophase.Estimate.report, cophase.Estimate.write, cophase.Estimate.correct.

    properties (SetAccess = private)
        info                  % sizes, status and figures, a struct; see help cophase.Estimate
        policy                % 'full' or 'realtime'
        method                % 'modal' or 'map'
        model                 % modes that were added to the scene's
        device                % device that the estimate ran on
        scene                 % scene that was used (TOML), with the choices of a plan and the optics that were fitted
        warnings              % what to know before using the numbers, a cell of sentences
        remarks               % remarks that hold for every image of the scene, a cell of sentences
        mode_names            % names of the modes, a cell column of text
        coefficients_nm       % coefficients, a column, nm
        sigma_nm              % standard deviation of each coefficient, a column, nm
        covariance_nm2        % covariance of the coefficients, nm^2
        image_coefficients_nm % coefficients of each image, modes x images, nm; [] in a MAP estimate
        phasing_nm            % phasing errors (y, x), nm
        ncpa_nm               % non-common path aberrations (y, x), nm
        phasing_sigma_nm      % standard deviation of each sample of phasing_nm, nm
        ncpa_sigma_nm         % standard deviation of each sample of ncpa_nm, nm
        images                % report on each image, a struct array: status ('OK', 'MISFIT', 'WRONG_MINIMUM',
                              % 'NOT_CONVERGED', 'UNUSABLE'), message, is_used, reduced_chi2, flux_e, ..., channel (from 1)
        channels              % names of the channels, a cell column of text; empty for a scene without
        integers              % segments x 3, for channels of several wavelengths: whole wavelengths of the first channel that were
                              % added to the piston, their probability, piston of the next most probable number relative to this, nm
        error_budget          % terms x 3, a cell: name, contributions to the error bars of phasing and NCPA, nm RMS
        model_errors          % errors of the optics and the camera that the error bars hold, a struct array: name, value, sigma,
                              % tolerance (sigma before the images), significance (value by the images alone over its error bar)
        without_staircases    % without focus and astigmatisms of the whole pupil, where a tolerance alone divides them between segments
                              % and NCPA: a struct of the maps phasing_nm, ncpa_nm, phasing_sigma_nm, ncpa_sigma_nm and of the struct info
                              % with their RMS and expected errors, as in info of the estimate; else []
    end

    methods
        function self = Estimate(estimator, frames, varargin)
            if nargin < 2
                error('cophase:BAD_ARGUMENT', 'frames is missing: use the method estimate of a cophase.Estimator');
            end
            [names, frames, chosen] = cophase.Estimate.of_channels(frames, varargin);
            self.create('estimate.create', cophase.Handle.number(estimator), names, frames, chosen);
            info = cophase_mex('estimate.info', self.id);
            self.info = info;
            self.method = info.method;
            self.policy = self.text('POLICY');
            self.model = self.text('MODEL');
            self.device = self.text('DEVICE');
            self.scene = self.text('SCENE');
            self.warnings = cophase.Handle.lines(self.text('WARNINGS'));
            self.remarks = cophase.Handle.lines(self.text('REMARKS'));
            self.mode_names = arrayfun(@(k) self.text('MODE_NAME', k), (1:info.modes)', 'UniformOutput', false);
            self.coefficients_nm = self.array('COEFFICIENTS_NM', info.modes);
            self.sigma_nm = self.array('SIGMA_NM', info.modes);
            % Symmetric up to rounding; the library has rows.
            self.covariance_nm2 = reshape(self.array('COVARIANCE_NM2', info.modes ^ 2), info.modes, info.modes)';
            if strcmp(info.method, 'modal')
                values = self.array('IMAGE_COEFFICIENTS_NM', info.images * info.modes);
                self.image_coefficients_nm = reshape(values, info.modes, info.images);
            end
            maps_nm = cophase.Handle.maps(self.array('MAPS_NM', 4 * info.samples ^ 2), info.samples, info.samples);
            self.phasing_nm = maps_nm(:, :, 1);
            self.ncpa_nm = maps_nm(:, :, 2);
            self.phasing_sigma_nm = maps_nm(:, :, 3);
            self.ncpa_sigma_nm = maps_nm(:, :, 4);
            images = cophase_mex('estimate.images', self.id, info.images);
            for k = 1:info.images
                images(k).message = self.text('IMAGE_MESSAGE', k);
                images(k).channel = images(k).channel + 1;
            end
            self.images = images;
            self.channels = arrayfun(@(k) self.text('CHANNEL_NAME', k), (1:info.channels)', 'UniformOutput', false);
            self.integers = reshape(self.array('PISTON_INTEGERS', 3 * info.integers), 3, [])';
            terms = arrayfun(@(k) self.text('ERROR_TERM_NAME', k), (1:info.error_terms)', 'UniformOutput', false);
            budget_nm = reshape(self.array('ERROR_BUDGET_NM', 2 * info.error_terms), 2, [])';
            self.error_budget = [terms, num2cell(budget_nm)];
            errors = reshape(self.array('MODEL_ERRORS', 4 * info.model_errors), 4, [])';
            names = arrayfun(@(k) self.text('MODEL_ERROR_NAME', k), (1:info.model_errors)', 'UniformOutput', false);
            self.model_errors = cell2struct([names, num2cell(errors)], {'name', 'value', 'sigma', 'tolerance', 'significance'}, 2);
            if info.has_maps_without_staircases
                values = self.array('MAPS_WITHOUT_STAIRCASES_NM', 4 * info.samples ^ 2);
                maps_nm = cophase.Handle.maps(values, info.samples, info.samples);
                figures_nm = self.array('FIGURES_WITHOUT_STAIRCASES_NM', 6);
                self.without_staircases = struct( ...
                    'phasing_nm', maps_nm(:, :, 1), 'ncpa_nm', maps_nm(:, :, 2), ...
                    'phasing_sigma_nm', maps_nm(:, :, 3), 'ncpa_sigma_nm', maps_nm(:, :, 4), ...
                    'info', struct('phasing_rms_nm', figures_nm(1), 'phasing_sigma_nm', figures_nm(2), 'ncpa_rms_nm', figures_nm(3), ...
                    'ncpa_sigma_nm', figures_nm(4), 'wavefront_rms_nm', figures_nm(5), 'wavefront_sigma_nm', figures_nm(6)));
            end
        end

        function text = report(self)
            %REPORT  The report, as the program prints it, warnings included.
            %   text = e.report()
            %
            %   See also cophase.Estimate.write.
            text = self.text('REPORT');
        end

        function write(self, path)
            %WRITE  Writes the estimate as FITS, whole or not at all.
            %   e.write(path)
            %
            %   See also cophase.Estimate.report.
            cophase_mex('estimate.write', self.id, path);
        end

        function result = correct(self, limit_nm, path)
            %CORRECT  What to add to segments, mirror and (of a MAP estimate) reference slopes.
            %   c = e.correct() returns a struct with the fields
            %      pistons_nm       what to add to the piston of each segment, nm of wavefront, which a positive piston
            %                       raises
            %      tilts_nm         segments x 2: what to add to the tip and to the tilt of each segment, nm of wavefront RMS
            %                       over the segment; 0 x 2 if the estimate has no tilts of segments
            %      actuators_nm     what to add to the command of each actuator, nm of wavefront, from which the mirror
            %                       is subtracted; empty where the scene names no mirror
            %      actuators_m      2 x actuators: position of each, x and y, m
            %      slopes_mas       what to add to the sensor's reference slopes, along x for every subaperture, then
            %                       along y: the loop then puts the correction on the mirror; empty where no slopes were
            %                       measured, and for a modal estimate
            %      segment_commands, actuator_commands  what to add to each channel of the controllers, in its unit, a
            %                       struct array with the fields name and add; empty where the scene describes no
            %                       controller ([commands])
            %      corrected_modes  NCPA modes that are corrected
            %      limited          commands that were cut at a limit
            %      segments_held, ncpa_held  cells: why each piston, then each tip, then each tilt, and each NCPA mode is
            %                       held: 'deadband', 'no-benefit' or 'never-corrected'; '' for one that is corrected
            %      segments_drop_nm2, ncpa_drop_nm2  expected drop of the sum of squares of the segment modes (of the steps
            %                       at edges by the convention edge-minimising), and of the NCPA modes, nm^2
            %      warnings         what to know before anything is moved, a cell of sentences
            %   Gain, deadband and convention are those of the scene's section [commands]. Errors whose correction is not expected to
            %   lower them are held, and so are tips and tilts of segments of a modal estimate.
            %
            %   c = e.correct(limit_nm) has no larger command; without it, or with [], the limit is the mirror's stroke
            %   and, for segments, a quarter of the wavelength (none where the whole wavelengths are known),
            %   or commands.max_step_nm of the scene. A piston that would move by more than that (unset and with one wavelength:
            %   half of it) is an error, BAD_VALUE.
            %   c = e.correct(limit_nm, path) also writes a FITS file, or text for a name that ends in .txt.
            %
            %   Example:
            %       c = e.correct(200);
            %       pistons_nm = pistons_nm + c.pistons_nm;
            %
            %   See also cophase.Estimator.estimate.
            if nargin < 2
                limit_nm = [];
            end
            if nargin < 3
                path = '';
            end
            found = cophase_mex('estimate.correct', self.id, limit_nm, path);
            result = struct('pistons_nm', self.array('CORRECTION_PISTONS_NM', found.segments), ...
                'tilts_nm', reshape(self.array('CORRECTION_TILTS_NM', found.tilts), [], 2), ...
                'actuators_nm', self.array('CORRECTION_ACTUATORS_NM', found.actuators), ...
                'actuators_m', reshape(self.array('CORRECTION_ACTUATORS_M', 2 * found.actuators), 2, []), ...
                'slopes_mas', self.array('CORRECTION_SLOPES_MAS', found.slopes), ...
                'corrected_modes', found.corrected_modes, 'limited', found.limited, ...
                'segments_drop_nm2', found.segments_drop_nm2, 'ncpa_drop_nm2', found.ncpa_drop_nm2);
            result.segments_held = self.texts('SEGMENT_HELD', found.segments + found.tilts);
            result.ncpa_held = self.texts('NCPA_HELD', found.ncpa_modes);
            result.warnings = cophase.Handle.lines(self.text('CORRECTION_WARNINGS'));
            result.segment_commands = self.commands('SEGMENT', found.segment_commands);
            result.actuator_commands = self.commands('ACTUATOR', found.actuator_commands);
        end
    end

    methods (Static, Access = private)
        function [names, frames, chosen] = of_channels(given, pairs)
            % Name, frames and options of each channel, in cells. Options that are structs have a field for each channel.
            if isstruct(given)
                names = fieldnames(given);
                frames = struct2cell(given);
            else
                if ~iscell(given)
                    given = {given};
                end
                names = cell(numel(given), 1);
                frames = given(:);
            end
            chosen = repmat({pairs}, numel(frames), 1);
            for p = 2:2:numel(pairs)
                if isstruct(pairs{p})
                    odd = setdiff(fieldnames(pairs{p}), names(~cellfun(@isempty, names)));
                    if ~isempty(odd)
                        error('cophase:BAD_VALUE', '%s has the channel %s, which frames has not', pairs{p - 1}, odd{1});
                    end
                    for k = 1:numel(frames)
                        chosen{k}{p} = [];
                        if isfield(pairs{p}, names{k})
                            chosen{k}{p} = pairs{p}.(names{k});
                        end
                    end
                end
            end
        end
    end

    methods (Access = private)
        function text = text(self, what, index)
            if nargin < 3
                index = 1;
            end
            text = cophase_mex('estimate.text', self.id, what, index);
        end

        function found = texts(self, what, count)
            % A cell for each of `count` texts.
            found = arrayfun(@(index) self.text(what, index), (1:count)', 'UniformOutput', false);
        end

        function values = array(self, what, count)
            values = cophase_mex('estimate.array', self.id, what, count);
        end

        function result = commands(self, what, count)
            % Names of the channels of a controller, and what to add to each.
            names = self.texts([what '_COMMAND_NAME'], count);
            add = num2cell(self.array(['CORRECTION_' what '_COMMANDS'], count));
            result = struct('name', names, 'add', add(:));
        end
    end
end
