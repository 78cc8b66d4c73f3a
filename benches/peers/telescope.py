"""The telescope that everybody is handed: Keck's 36 hexagons on a square grid, 102 modes, a defocus.

Conventions are those of the files that `cophase image` writes: arrays are [y, x], the optical axis lies between the two
central samples, segments are numbered ring by ring and counter-clockwise from +x, modes are nm of wavefront.
"""

from dataclasses import dataclass

import numpy as np
from prysm.polynomials import noll_to_nm, zernike_nm

GRID_M = 10.95
SIDE_M, GAP_M, RINGS = 0.9, 0.003, 3
WAVELENGTH_NM = 2168.6
DEFOCUS_WAVES = 1.5
#: Noll indices of the non-common path modes: with 36 pistons 102 modes, which span the truth (Noll 4 to 18).
NOLL = range(2, 68)
#: Points along a side of a sample that decide how much of it is glass.
SUPERSAMPLING = 16


def centres_m():
    """Centres of the segments, (segments, 2) as x and y; the central hexagon is absent."""
    pitch = np.sqrt(3) * SIDE_M + GAP_M
    # Hexagons with a vertex on +x have their neighbours at 30 and 90 degrees.
    along, up = pitch * np.array([np.sqrt(3) / 2, 0.5]), pitch * np.array([0.0, 1.0])
    rings = []
    for a in range(-RINGS, RINGS + 1):
        for b in range(-RINGS, RINGS + 1):
            ring = max(abs(a), abs(b), abs(a + b))
            if 0 < ring <= RINGS:
                x, y = a * along + b * up
                # Rounded, so that an angle of -1e-17 does not become 2 pi.
                rings.append((ring, round(np.arctan2(y, x) % (2 * np.pi), 9) % round(2 * np.pi, 9), x, y))
    return np.array([(x, y) for _, _, x, y in sorted(rings)])


def coordinates_m(samples):
    """x or y of the samples."""
    return (np.arange(samples) - (samples - 1) / 2) * GRID_M / samples


def nearest(x, y):
    """The segment whose centre is closest to each point."""
    return np.argmin([np.hypot(x - cx, y - cy) for cx, cy in centres_m()], axis=0)


def glass(samples):
    """Where there is glass."""
    fine = coordinates_m(samples)
    x, y = np.meshgrid(fine, fine)
    inside = np.zeros(x.shape, bool)
    apothem = np.sqrt(3) / 2 * SIDE_M
    for cx, cy in centres_m():
        near = np.ix_(np.abs(fine - cy) < SIDE_M, np.abs(fine - cx) < SIDE_M)
        dx, dy = x[near] - cx, y[near] - cy
        sides = [np.abs(dx * np.cos(t) + dy * np.sin(t)) for t in np.radians([30, 90, 150])]
        inside[near] |= np.max(sides, axis=0) <= apothem
    return inside, x, y


def zernikes(x, y, nolls):
    """Noll's polynomials on the circle around the segments, (modes, *shape of x), unit RMS over that circle."""
    radius_m = np.hypot(*centres_m().T).max() + SIDE_M
    rho, theta = np.hypot(x, y) / radius_m, np.arctan2(y, x)
    return np.stack([zernike_nm(*noll_to_nm(noll), rho, theta, norm=True) for noll in nolls])


@dataclass
class Telescope:
    """A sampled telescope.

    Attributes
    ----------
    amplitude : (n, n) array
    labels : (n, n) array
        The segment of each sample with glass, -1 elsewhere.
    ncpa : (66, n, n) array
        Modes, nm per nm.
    diversity_nm : (n, n) array
    """

    amplitude: np.ndarray
    labels: np.ndarray
    ncpa: np.ndarray
    diversity_nm: np.ndarray

    @classmethod
    def of(cls, samples):
        x, y = np.meshgrid(*2 * [coordinates_m(samples)])
        inside, fine_x, fine_y = glass(samples * SUPERSAMPLING)
        weight = inside.reshape(samples, SUPERSAMPLING, samples, SUPERSAMPLING).mean(axis=(1, 3))
        lit = weight > 0
        # Zero mean and unit RMS over the glass, before it is scaled; on the fine grid, because on 120 samples the RMS is off
        # by 1e-4 of itself, 0.3 nm.
        fine_focus = (fine_x**2 + fine_y**2)[inside]
        focus = (x**2 + y**2 - fine_focus.mean()) / fine_focus.std()
        return cls(
            amplitude=weight,
            labels=np.where(lit, nearest(x, y), -1),
            ncpa=zernikes(x, y, NOLL) * lit,
            diversity_nm=DEFOCUS_WAVES * WAVELENGTH_NM * focus * lit,
        )

    @property
    def segments(self):
        return self.labels.max() + 1

    @property
    def modes(self):
        """Pistons, then NCPA: how many."""
        return self.segments + len(self.ncpa)

    def mode_maps(self):
        """All modes, (modes, n, n)."""
        pistons = self.labels == np.arange(self.segments)[:, None, None]
        return np.concatenate([pistons.astype(float), self.ncpa])
