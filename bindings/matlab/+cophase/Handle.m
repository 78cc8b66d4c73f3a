classdef Handle < handle
    %HANDLE  Base of the classes of this package: an object of the library.
    %   It is freed with the last variable that holds it, or by delete. Objects do not depend on the lifetime of those
    %   that they were made from.
    %
    %   See also cophase.Estimator, cophase.Estimate, cophase.Model, cophase.Session, cophase.Sequence,
    %   cophase.Simulator.

    properties (Hidden, SetAccess = private)
        id = 0 % number of the object in the gateway; 0 for none
    end

    methods
        function delete(self)
            %DELETE  Frees the object.
            if self.id ~= 0
                id = self.id;
                self.id = 0;
                cophase_mex('delete', id);
            end
        end
    end

    methods (Access = protected)
        function create(self, command, varargin)
            % Makes the object by a command of the gateway.
            self.id = cophase.Handle.call(command, varargin{:});
        end
    end

    methods (Static, Hidden)
        function varargout = call(command, varargin)
            % A command of the gateway that needs no object: the first of a program.
            try
                [varargout{1:max(nargout, 1)}] = cophase_mex(command, varargin{:});
            catch failure
                if any(strcmp(failure.identifier, {'Octave:undefined-function', 'MATLAB:UndefinedFunction'}))
                    folder = fileparts(fileparts(mfilename('fullpath')));
                    error('cophase:BAD_FILE', ['cophase_mex, the compiled part of this package, is not on the path: run ' ...
                        'build in %s first, or add the folder where build put it'], folder);
                end
                rethrow(failure);
            end
        end

        function [text, directory] = read_scene(scene)
            % Text of the scene that a caller means, and the directory of its file; '' where there is none. A scene is a
            % file, a preset where there is no file of its name, as for the program's --scene, or the text itself. A text
            % has a line break or an equals sign, because every scene has one.
            text = scene;
            directory = '';
            if isa(scene, 'string') && numel(scene) == 1
                scene = char(scene);
            end
            is_name = ischar(scene) && size(scene, 1) == 1 && ~isempty(strtrim(scene)) && ...
                ~any(scene == sprintf('\n') | scene == '=');
            if ~is_name
                return
            elseif isfile(scene)
                information = dir(scene);
                if information(1).bytes > 2^20
                    error('cophase:BAD_FILE', '%s: has %d bytes: at most 1048576 are accepted of a scene', scene, information(1).bytes);
                end
                text = fileread(scene);
                directory = fileparts(scene);
            elseif any(scene == '.' | scene == '/' | scene == filesep())
                error('cophase:BAD_FILE', ['%s: there is no such file of a scene: a file, the name of a preset such as ' ...
                    'keck-artificial, or the text of a scene is accepted'], scene);
            else
                text = cophase.preset(scene);
            end
        end

        function id = number(value)
            % Number of an object; 0, which the gateway refuses, for any other value.
            id = 0;
            if isa(value, 'cophase.Handle') && numel(value) == 1
                id = value.id;
            end
        end

        function number = channel_number(channels, channel)
            % Number, from 1, of a channel that is given by its name or number.
            number = channel;
            if ischar(channel)
                number = find(strcmp(channels, channel));
                if isempty(number)
                    error('cophase:BAD_VALUE', 'the channel is ''%s'': one of %s is accepted', channel, ...
                        strjoin(channels', ', '));
                end
            end
        end

        function maps = maps(values, rows, cols)
            % Maps (y, x, k) of a column in C order.
            maps = permute(reshape(values, cols, rows, []), [2 1 3]);
        end

        function lines = lines(text)
            % Lines of a text, a cell column.
            if isempty(text)
                lines = {};
            else
                lines = strsplit(text, sprintf('\n'))';
            end
        end
    end
end
