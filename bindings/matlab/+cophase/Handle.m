classdef Handle < handle
    %HANDLE  What the classes of this package have in common: an object of the library's.
    %   It is freed with the last variable that holds it, or by delete. Those that were made from it live on.
    %
    %   See also cophase.Model, cophase.Session, cophase.Sequence, cophase.Simulator,
    %   cophase.FullPhase.

    properties (Hidden, SetAccess = private)
        id = 0 % the gateway's number for it; 0 is nobody's
    end

    properties (Access = private)
        noun = ''
    end

    methods
        function delete(self)
            %DELETE  Frees the object.
            if self.id ~= 0
                id = self.id;
                self.id = 0;
                cophase_mex([self.noun '.delete'], id);
            end
        end
    end

    methods (Access = protected)
        function varargout = create(self, noun, varargin)
            % Creates the object; returns what the gateway returns after its number.
            results = cell(1, nargout + 1);
            [results{:}] = cophase_mex([noun '.create'], varargin{:});
            self.noun = noun;
            self.id = results{1};
            varargout = results(2:end);
        end
    end

    methods (Static, Hidden)
        function id = of(value)
            % The number of an object; 0, which the gateway refuses, for anything else.
            id = 0;
            if isa(value, 'cophase.Handle') && numel(value) == 1
                id = value.id;
            end
        end
    end
end
