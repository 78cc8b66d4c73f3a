"""JAX: the forward model in f32, its gradient by automatic differentiation, compiled; a batch by vmap.

Transforms are written twice, as a padded FFT and as two matrix products; the faster one counts.

JAX's own BFGS stops at errors of 50 nm where it begins with the gradient's direction: in f32 its line search finds no
descent. It gets our metric, then, the Gauss-Newton matrix of the flat wavefront, in which BFGS begins as Newton's method.
"""

import functools

import jax
import jax.numpy as jnp
import jax.scipy.optimize
import numpy as np
from numpy_model import NM, bfgs
from telescope import Telescope

NAME = "JAX"


class Model:
    """One image at a time, or a batch."""

    def __init__(self, telescope: Telescope, pixels: int, transform: str) -> None:
        samples = len(telescope.amplitude)
        self.pixels, self.modes = pixels, telescope.modes
        lit = np.flatnonzero(telescope.labels >= 0)
        maps = jnp.asarray(telescope.mode_maps().reshape(self.modes, -1)[:, lit] / NM, jnp.float32)
        amplitude = telescope.amplitude.ravel()[lit]
        amplitude = amplitude / np.sqrt((amplitude**2).sum()) / pixels
        aperture = jnp.asarray(amplitude, jnp.float32)
        diversity = jnp.asarray(telescope.diversity_nm.ravel()[lit] / NM, jnp.float32)
        frequency = np.fft.fftfreq(pixels)[:, None] * np.arange(samples)
        matrix = jnp.asarray(np.exp(-2j * np.pi * frequency), jnp.complex64)

        def psf_of(coefficients_nm):
            phase = coefficients_nm @ maps + diversity
            field = aperture * jax.lax.complex(jnp.cos(phase), jnp.sin(phase))
            pupil = jnp.zeros(samples**2, jnp.complex64).at[lit].set(field).reshape(samples, samples)
            if transform == "fft":
                focus = jnp.fft.fft(jnp.fft.fft(pupil, pixels, axis=1), pixels, axis=0)
            else:
                focus = matrix @ pupil @ matrix.T
            return focus.real**2 + focus.imag**2

        def objective(coefficients_nm, data, weights):
            psf = psf_of(coefficients_nm)
            flux = jax.lax.stop_gradient((weights * psf * data).sum() / (weights * psf**2).sum())
            return (weights * (flux * psf - data) ** 2).sum()

        def minimum(data, weights, metric):
            # Its line search begins with a step of length 1: the first step is made that long.
            start = jnp.zeros(metric.shape[1], jnp.float32)
            length = jnp.linalg.norm(metric.T @ jax.grad(objective)(metric @ start, data, weights))

            def scaled(z):
                return objective(length * (metric @ z), data, weights) / length**2

            options = {"gtol": 1 / length}
            return length * (metric @ jax.scipy.optimize.minimize(scaled, start, method="BFGS", options=options).x)

        self._slopes = jax.jit(jax.jacfwd(psf_of))
        self._evaluate = jax.jit(jax.value_and_grad(objective))
        self._evaluate_batch = jax.jit(jax.vmap(jax.value_and_grad(objective)))
        self._minimum_batch = jax.jit(jax.vmap(minimum, (0, 0, None)))

    def load(self, electrons: np.ndarray, weights: np.ndarray) -> None:
        """An image, or a stack."""
        turned = functools.partial(np.fft.ifftshift, axes=(-2, -1))
        self.data = jnp.asarray(turned(electrons), jnp.float32)
        self.weights = jnp.asarray(turned(weights), jnp.float32)

    def evaluate(self, coefficients_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """J and its gradient per nm, of an image or of each image of the stack."""
        call = self._evaluate if self.data.ndim == 2 else self._evaluate_batch
        value, gradient = call(jnp.asarray(coefficients_nm, jnp.float32), self.data, self.weights)
        return np.asarray(value), np.asarray(gradient)

    def estimate(self) -> np.ndarray:
        """SciPy's BFGS for an image, JAX's own for a stack."""
        if self.data.ndim == 2:
            return bfgs(self.evaluate, self.modes, self.pixels**2)
        return np.asarray(self._minimum_batch(self.data, self.weights, self.metric))

    @functools.cached_property
    def metric(self) -> jax.Array:
        """Takes coordinates in which J is round about its minimum to nm, (modes, modes - 1): global piston is not seen.

        Once per scene: the weights are those of its first image.
        """
        slopes = np.asarray(self._slopes(jnp.zeros(self.modes)), float).reshape(-1, self.modes)
        weights = np.asarray(self.weights[0], float).ravel()
        flux = float(np.asarray(self.data[0], float).sum())
        scale, directions = np.linalg.eigh(2 * flux**2 * slopes.T @ (weights[:, None] * slopes))
        return jnp.asarray(directions[:, 1:] / np.sqrt(scale[1:]), jnp.float32)
