function list = devices()
    %DEVICES  Devices of this machine.
    %   list = cophase.devices() returns a struct for each device, with the fields name, for the option 'device' of
    %   cophase.Session, and description. The first is always the CPU.
    %
    %   Example:
    %       list = cophase.devices();
    %       s = cophase.Session(m, 'device', list(end).name);
    %
    %   See also cophase.Session.
    lines = regexp(cophase.Handle.call('devices'), '([^\t\n]*)\t([^\n]*)', 'tokens');
    list = struct('name', cell(numel(lines), 1), 'description', '');
    for i = 1:numel(lines)
        [list(i).name, list(i).description] = lines{i}{:};
    end
end
