function text = preset(name)
    %PRESET  Text of a scene that comes with the library.
    %   text = cophase.preset(name), where name is that of a scene of the library, such as
    %   'keck-artificial', 'keck-onsky' or 'jwst-pair'; the error of another name lists all.
    %
    %   Example:
    %       disp(cophase.preset('keck-artificial'))
    %
    %   See also cophase.scene_set, cophase.Estimator, cophase.Model, cophase.Simulator.
    text = cophase.Handle.call('preset', name);
end
