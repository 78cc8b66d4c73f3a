"""What the Python tests share."""

import numpy as np

COUNT = 3
FLUX_E, BACKGROUND_E, READ_NOISE_E = 2e6, 30.0, 10.0


def failure(call, kind=Exception):
    """The failure that ``call`` must raise: of this very kind, in one sentence."""
    try:
        call()
    except Exception as error:
        assert type(error) is kind or kind is Exception, repr(error)
        assert str(error) and "\n" not in str(error), repr(error)
        return error
    raise AssertionError(f"nothing was raised where {kind.__name__} was due")


def star(model, truth_nm, random):
    """A frame, whole electrons: the PSF about the optical axis over a background, with photon and read noise."""
    rows, cols = model.frame_shape
    pixels = model.pixels
    frame = np.full((rows, cols), BACKGROUND_E)
    down, right = min(rows, pixels) // 2, min(cols, pixels) // 2
    axis = pixels // 2
    window = np.s_[axis - down : axis + down, axis - right : axis + right]
    frame[rows // 2 - down : rows // 2 + down, cols // 2 - right : cols // 2 + right] += (
        FLUX_E * model.psf(truth_nm)[window]
    )
    frame += np.sqrt(frame + READ_NOISE_E**2) * random.standard_normal(frame.shape)
    return np.round(frame).clip(0, 65535)


def stars(model):
    """Frames (COUNT, rows, cols) and what is behind them, nm (COUNT, modes)."""
    random = np.random.default_rng(7)
    truth_nm = 25 * random.standard_normal((COUNT, model.modes))
    return np.stack([star(model, truth, random) for truth in truth_nm]), truth_nm
