% What the Octave tests share; they source it.

1; % a script, not a function of this file's name

% The call must raise cophase:<ID>, with one sentence that holds `part`.
function must_fail(id, part, call)
    try
        call();
    catch failure
        as_due = strcmp(failure.identifier, ['cophase:' id]) && ~any(failure.message == "\n") && ...
            (isempty(part) || ~isempty(strfind(failure.message, part)));
        assert(as_due, 'cophase:%s about %s was due, not %s: %s', id, part, failure.identifier, failure.message);
        return
    end
    error('nothing was raised where cophase:%s was due', id);
end
