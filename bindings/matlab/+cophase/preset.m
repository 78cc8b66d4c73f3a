function text = preset(name)
    %PRESET  Text of a scene that comes with the library.
    %   text = cophase.preset(name), where name is 'keck-artificial' or 'keck-onsky'.
    %
    %   Example:
    %       m = cophase.Model(cophase.preset('keck-artificial'));
    %
    %   See also cophase.scene_set, cophase.Estimator, cophase.Model, cophase.Simulator.
    text = cophase_mex('preset', name);
end
