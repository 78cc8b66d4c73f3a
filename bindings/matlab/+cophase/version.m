function text = version()
    %VERSION  Version of the library that is loaded.
    %   text = cophase.version() returns text such as '0.1.0'.
    %
    %   See also cophase.devices, cophase.preset.
    text = cophase.Handle.call('version');
end
