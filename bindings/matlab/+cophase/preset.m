function text = preset(name)
    %PRESET  The text of a scene that comes with the library.
    %   text = cophase.preset(name), name being 'keck-artificial' or 'keck-onsky'.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %
    %   See also cophase.Model, cophase.Simulator.
    text = cophase_mex('preset', name);
end
