% A round pupil and two modes of it.
[x, y] = meshgrid(linspace(-1, 1, 64));
pupil = double(x .^ 2 + y .^ 2 <= 1);
modes = cat(3, x .* y, x .^ 2 - y .^ 2);
