function text = scene_set(scene, varargin)
    %SCENE_SET  Scene with other values for some keys; its comments stay.
    %   text = cophase.scene_set(scene, KEY, VALUE, ...) returns the text of a scene, which is a TOML file, the name of a
    %   preset, or a text, with each key, section and name, set to its value: a number, a logical, a row of numbers or a
    %   cell (a list), a text (words and file names need no quotes), or [] for the key's default. Units are in the keys'
    %   names; 'cophase scene --reference' describes them. Keys are set one after the other, each in a valid scene.
    %
    %   Names of files in the scene stay as they are: where they are relative to the directory of its file, give that as
    %   directory to what takes the text.
    %
    %   A key that does not exist, or a value that it does not accept, raises cophase:BAD_SCENE.
    %
    %   Example:
    %       scene = cophase.scene_set('keck-artificial', 'image.peak_snr', 50, 'estimate.fit_optics', {'plate-scale'});
    %       e = cophase.Estimator(scene).estimate(frames);
    %
    %   See also cophase.preset, cophase.Estimator, cophase.Model, cophase.Simulator.
    if nargin < 1
        error('cophase:BAD_ARGUMENT', 'scene is missing: a file, a preset or the text of a scene is accepted');
    end
    if mod(numel(varargin), 2) == 1
        error('cophase:BAD_ARGUMENT', 'the last key has no value: KEY, VALUE, ... is accepted');
    end
    text = cophase.Handle.read_scene(scene);
    for i = 1:2:numel(varargin)
        text = cophase.Handle.call('scene_set', text, varargin{i}, toml(varargin{i + 1}));
    end
end

% A value as the library reads it.
function text = toml(value)
    if iscell(value)
        items = cellfun(@item, value(:).', 'UniformOutput', false);
        text = ['[' strjoin(items, ', ') ']'];
    elseif ischar(value) || isa(value, 'string')
        text = value;
    elseif isempty(value)
        text = '';
    elseif ~(isnumeric(value) || islogical(value)) || ~isreal(value) || size(value, 1) > 1 || ndims(value) > 2
        error('cophase:BAD_ARGUMENT', ['a value of class %s and size %s was given: a real number, a logical, a row ' ...
            'of them, a cell or a text is accepted'], class(value), mat2str(size(value)));
    elseif numel(value) > 1
        text = toml(num2cell(value));
    elseif islogical(value)
        names = {'false', 'true'};
        text = names{value + 1};
    else
        % The shortest that is read as the same number.
        text = sprintf('%.15g', value);
        if str2double(text) ~= double(value)
            text = sprintf('%.17g', value);
        end
    end
end

% An item of a list, in which texts need quotes.
function text = item(value)
    text = toml(value);
    if ischar(value) || isa(value, 'string')
        text = ['"' char(text) '"'];
    end
end
