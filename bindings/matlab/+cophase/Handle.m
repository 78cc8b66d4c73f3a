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
            self.id = cophase_mex(command, varargin{:});
        end
    end

    methods (Static, Hidden)
        function id = number(value)
            % Number of an object; 0, which the gateway refuses, for any other value.
            id = 0;
            if isa(value, 'cophase.Handle') && numel(value) == 1
                id = value.id;
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
