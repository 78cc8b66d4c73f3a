//! Buffers that each wavelength has for itself.

use super::fold::{Blocks, FoldedShape, GROUP};
use super::layout::GpuLayout;
use super::memory::{Counts, Partition, padded};
use crate::Result;
use crate::device::{Build, Device, Precision, Reals};

/// Sizes of the arrays of one wavelength, numbers; padded, because the array of the next wavelength
/// begins where a part of a buffer may.
#[derive(Debug, Clone, Copy)]
pub(super) struct ColourSizes {
    /// The four tables, in the order of [`FoldedShape::tables`].
    pub tables: [usize; 4],
    pub excess: usize,
    /// Of one image, as those below. A tile and a padded batch are whole groups of images.
    pub pose: usize,
    pub phasor: usize,
    pub focal: usize,
}

impl ColourSizes {
    pub fn new(device: &Device, precision: Precision, shape: &FoldedShape, counts: &Counts) -> Result<Self> {
        let aligned = device.part_alignment_bytes()?.div_ceil(precision.bytes());
        let each = |numbers: usize| numbers.max(1).next_multiple_of(aligned);
        let per_image = |numbers: usize| numbers.next_multiple_of(aligned.div_ceil(GROUP));
        let [y_to_v, x_to_u, u_to_x, v_to_y, _] = shape.table_sizes();
        Ok(Self {
            tables: [y_to_v, x_to_u, u_to_x, v_to_y].map(each),
            excess: each(counts.blocks * 4 * shape.vector),
            pose: per_image(counts.segments * 4),
            phasor: per_image(counts.blocks * 8 * shape.vector),
            focal: per_image(shape.pixels() * 2),
        })
    }
}

/// An array of each wavelength, one after the other in one buffer: `focus_stored` is bound to the
/// whole, the kernels of one wavelength to its part.
pub(super) struct PerColour {
    pub whole: Reals,
    pub parts: Vec<Reals>,
    /// Numbers from the array of one wavelength to that of the next.
    pub apart: usize,
}

impl PerColour {
    fn new(device: &Device, precision: Precision, colours: usize, apart: usize) -> Result<Self> {
        let whole = Reals::zeros(device, precision, colours * apart)?;
        let parts = (0..colours).map(|colour| whole.part(colour * apart, apart)).collect::<Result<_>>()?;
        Ok(Self { whole, parts, apart })
    }
}

/// Buffers of the wavelengths: scale, diversity and tables, constant after construction; poses;
/// fields, which are kept from the forward model to the adjoint.
pub(super) struct ColourBuffers {
    /// The first wavelength over each.
    pub scales: Reals,
    /// See `field.cl`.
    pub excess: PerColour,
    pub y_to_v: PerColour,
    pub x_to_u: PerColour,
    pub u_to_x: PerColour,
    pub v_to_y: PerColour,
    /// `[image][segment][re q, im q, tip, tilt]`.
    pub pose: PerColour,
    /// For the images processed at a time, as the next two.
    pub focal: PerColour,
    pub phasor: PerColour,
    pub sample_field: PerColour,
}

impl ColourBuffers {
    pub fn new(
        device: &Device,
        build: Build,
        (layout, blocks): (&GpuLayout, &Blocks),
        (counts, sizes, partition): (&Counts, &ColourSizes, &Partition),
    ) -> Result<Self> {
        let colours = layout.colours.len();
        let each = |apart: usize| PerColour::new(device, build.precision, colours, apart);
        let per_image = |images: usize, numbers: usize| each(images * numbers);
        let [y_to_v, x_to_u, u_to_x, v_to_y] = sizes.tables;
        let scales: Vec<f64> = (0..colours).map(|colour| layout.phase_scale(colour)).collect();
        let mut buffers = Self {
            scales: Reals::upload(device, build.precision, &scales)?,
            excess: each(sizes.excess)?,
            y_to_v: each(y_to_v)?,
            x_to_u: each(x_to_u)?,
            u_to_x: each(u_to_x)?,
            v_to_y: each(v_to_y)?,
            pose: per_image(padded(counts.capacity), sizes.pose)?,
            focal: per_image(partition.focal_tile, sizes.focal)?,
            phasor: per_image(partition.focal_tile, sizes.phasor)?,
            sample_field: per_image(partition.focal_tile, sizes.phasor)?,
        };
        for (colour, own) in layout.colours.iter().enumerate() {
            let shape = FoldedShape::new(layout, own, build);
            buffers.excess.parts[colour].write(0, &blocks.excess(layout, colour, build))?;
            if shape.fft.is_some() {
                continue;
            }
            let tables = [&mut buffers.y_to_v, &mut buffers.x_to_u, &mut buffers.u_to_x, &mut buffers.v_to_y];
            for (table, values) in tables.into_iter().zip(shape.tables()) {
                table.parts[colour].write(0, &values)?;
            }
        }
        Ok(buffers)
    }
}
