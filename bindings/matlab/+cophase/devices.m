function list = devices()
    %DEVICES  Where images can be fitted.
    %   list = cophase.devices() returns a struct for each device, with the fields Address, for the option 'Device' of
    %   cophase.Session, and Name.
    %
    %   Example:
    %       list = cophase.devices();
    %       s = cophase.Session(m, 'Device', list(end).Address);
    %
    %   See also cophase.Session.
    lines = regexp(cophase_mex('devices'), '([^\t\n]*)\t([^\n]*)', 'tokens');
    list = struct('Address', cell(numel(lines), 1), 'Name', '');
    for i = 1:numel(lines)
        [list(i).Address, list(i).Name] = lines{i}{:};
    end
end
