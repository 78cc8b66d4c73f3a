"""What aotpy, the reference implementation of AOT, makes of a file, and files that it makes.

    aot.py read OURS AGAIN      reads OURS without a complaint, and writes what it read as AGAIN
    aot.py make OWN FOLDER      writes files of AOT from the images and slopes of OWN, a FITS file of 'cophase simulate'
"""

import sys

import aotpy
import numpy as np
from aotpy.io.fits._file import AOTFITSErrorLevel, AOTFITSFile
from aotpy.io.fits.writer import AOTFITSWriter
from astropy.io import fits


def read(ours, again):
    file = AOTFITSFile.from_file(ours, log_level=AOTFITSErrorLevel.CRITICAL)
    complaints = [text for texts in file.issue_manager.error.values() for _, text in texts]
    # Cards that the standard leaves free: program, date, comments.
    complaints = [text for text in complaints if not text.startswith("Found non-AOT keywords")]
    assert not complaints, complaints
    extra_hdus, extra_images, extra_columns = file.get_extra_data()
    assert not extra_hdus and not extra_images and not any(extra_columns.values())

    system = aotpy.AOSystem.read_from_file(ours)
    camera, sensor, mirror, loop = (
        system.scoring_cameras[0],
        system.wavefront_sensors[0],
        system.wavefront_correctors[0],
        system.loops[0],
    )
    images = camera.detector.pixel_intensities
    exposures = len(images.data)
    slopes, subapertures = sensor.measurements.data, sensor.n_valid_subapertures
    actuators = mirror.n_valid_actuators
    assert images.time.timestamps == loop.time.timestamps and len(images.time.timestamps) == exposures
    assert slopes.shape == (exposures, 2, subapertures) and sensor.measurements.unit == "mas"
    mask = sensor.subaperture_mask.data
    assert sorted(mask[mask >= 0]) == list(range(subapertures))
    assert loop.commands.data.shape == (exposures, actuators) and loop.commands.unit == "m"
    assert len(mirror.actuator_coordinates) == actuators
    assert loop.control_matrix.data.shape == (actuators, 2, subapertures)
    assert loop.interaction_matrix.data.shape == (subapertures, 2, actuators)
    # The control matrix inverts the interaction matrix on the modes that are controlled: D R D = D there, and R D R = R.
    control = loop.control_matrix.data.reshape(actuators, -1)
    interaction = loop.interaction_matrix.data.transpose(1, 0, 2).reshape(-1, actuators)
    # Rounding of an inverse with a condition number below 1e4, the largest of this loop.
    assert np.allclose(control @ interaction @ control, control, rtol=0, atol=1e-9 * np.abs(control).max())
    segments = system.main_telescope.segments
    assert isinstance(segments, aotpy.HexagonalSegments) and len(segments.coordinates) == 7
    assert system.main_telescope.aberration is not None and camera.aberration is not None
    assert camera.wavelength == 2168.6e-9 or abs(camera.wavelength / 2168.6e-9 - 1) < 1e-15
    assert len(system.atmosphere_params) == 1 and system.atmosphere_params[0].r0 == [0.2]
    system.write_to_file(again, overwrite=True)


def make(own, folder):
    with fits.open(own) as file:
        images = file["IMAGES"].data.copy()
        slopes = file["SLOPES_MEAN"].data.copy()
        times = list(file["SHOTS"].data["TIME_S"].astype(float))
        places = file["SUBAPERTURES"].data["PLACE"].copy()
    count, across = len(places), 10
    slopes = slopes.reshape(len(images), 2, count)

    def system(**parts):
        telescope = aotpy.MainTelescope(uid="Telescope")
        star = aotpy.NaturalGuideStar(uid="Star")
        detector = aotpy.Detector(uid="Camera detector", pixel_intensities=parts.get("images"), integration_time=0.0)
        camera = aotpy.ScoringCamera(
            uid="Camera", wavelength=2168.6e-9, detector=detector if parts.get("detector", True) else None
        )
        sensor = aotpy.ShackHartmann(
            uid="Sensor",
            source=star,
            n_valid_subapertures=count,
            measurements=parts.get("slopes"),
            subaperture_mask=parts.get("mask"),
        )
        mirror = aotpy.DeformableMirror(uid="Mirror", telescope=telescope, n_valid_actuators=1)
        loop = aotpy.ControlLoop(
            uid="Loop", commanded_corrector=mirror, input_sensor=sensor, time=parts.get("time"), framerate=1054.0
        )
        return aotpy.AOSystem(
            ao_mode="SCAO",
            name="Another",
            config="written by hand",
            main_telescope=telescope,
            sources=[star],
            scoring_cameras=[camera] if parts.get("camera", True) else [],
            wavefront_sensors=[sensor],
            wavefront_correctors=[mirror],
            loops=[loop],
        )

    def write(name, parts, edit=lambda hdus: hdus):
        edit(AOTFITSWriter(system(**parts)).get_hdulist()).writeto(f"{folder}/{name}", overwrite=True)

    def pictures(**more):
        return aotpy.Image("Pictures", images, unit="electron", **more)

    # Another numbering of the subapertures, extensions in the reverse order, a frame of the loop between two exposures: the times of
    # the slopes are those of the loop.
    mask = np.full((across, across), -1, dtype=np.int16)
    mask[places // across, places % across] = np.arange(count)[::-1]
    frames = np.stack([slopes[:, :, ::-1], np.full_like(slopes, 1e3)], axis=1).reshape(-1, 2, count)
    loop_times = [seconds for time in times for seconds in (time, time + 0.01)]
    odd = {
        "images": pictures(time=aotpy.Time(uid="Exposures", timestamps=times)),
        "slopes": aotpy.Image("Slopes", frames, unit="mas"),
        "mask": aotpy.Image("Mask", mask),
        "time": aotpy.Time(uid="Frames", timestamps=loop_times),
    }
    write("odd.fits", odd, lambda hdus: fits.HDUList([hdus[0], *hdus[:0:-1]]))
    bare = {"images": pictures(), "slopes": aotpy.Image("Slopes", slopes, unit="mas")}
    write("bare.fits", bare)
    write("arcsec.fits", bare | {"slopes": aotpy.Image("Slopes", slopes.astype(float) / 1e3, unit="arcsec")})
    write("few.fits", bare | {"slopes": aotpy.Image("Slopes", slopes[1:], unit="mas")})
    write("no-slopes.fits", {"images": pictures()})
    write("no-images.fits", bare | {"images": None})
    write("no-detector.fits", bare | {"detector": False})
    write("no-camera.fits", bare | {"camera": False})
    write("unit.fits", bare | {"slopes": aotpy.Image("Slopes", slopes, unit="furlong")})
    write("mask.fits", odd | {"mask": aotpy.Image("Mask", mask + (mask == 3))})


{"read": read, "make": make}[sys.argv[1]](*sys.argv[2:])
