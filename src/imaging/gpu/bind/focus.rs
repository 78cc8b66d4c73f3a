//! The arguments of the kernels of `focus.cl` and `fft.cl`.

use super::Bindings;
use crate::Result;
use crate::device::Kernel;

impl Bindings<'_> {
    /// The kernel that joins those from the phase to the projection on segments.
    pub(super) fn focus(&self) -> Result<Kernel> {
        let (colours, scratch) = (self.colours, self.scratch);
        let (fft, stored) = (self.shape.fft.is_some(), self.counts.stored_pixels > 0);
        let mut k = self.kernel(match (fft, stored) {
            (true, _) => "focus_fft",
            (false, false) => "focus",
            (false, true) => "focus_stored",
        })?;
        self.focus_images(&mut k)?;
        self.focus_pupil(&mut k)?;
        for (argument, array) in [
            ("phasor", &colours.phasor),
            ("sample_field", &colours.sample_field),
            ("focal", &colours.focal),
            ("y_to_v", &colours.y_to_v),
            ("x_to_u", &colours.x_to_u),
            ("u_to_x", &colours.u_to_x),
            ("v_to_y", &colours.v_to_y),
        ] {
            if !(fft && argument.contains("_to_")) {
                array.whole.bind(&mut k, argument)?;
            }
        }
        if fft {
            self.model.twiddle.bind(&mut k, "twiddle")?;
            scratch.line.bind(&mut k, "line")?;
            scratch.side.bind(&mut k, "side")?.int("side_rows", self.shape.side_rows())?;
        } else {
            k.int("rows", self.shape.rows)?.int("pairs", self.shape.pairs)?.int("span", self.shape.span)?;
            k.int("pairs_per_strip", self.partition.pairs_per_strip)?.int("strips", self.counts.strips)?;
        }
        if stored {
            self.focus_colours(&mut k)?;
        }
        Ok(k)
    }

    /// The arguments of `focus` that concern images and sums.
    fn focus_images(&self, k: &mut Kernel) -> Result<()> {
        let (scratch, batch) = (self.scratch, self.batch);
        for (argument, reals) in [
            ("psi", &scratch.psi),
            ("segment_sum", &scratch.segment_sum),
            ("field", &scratch.field),
            ("wave", &scratch.wave),
            ("sums", &scratch.sums),
            ("objective", &scratch.objective),
            ("photometry", &scratch.photometry),
            ("data", &batch.data),
            ("weight", &batch.weight),
            ("known", &batch.known),
        ] {
            reals.bind(k, argument)?;
        }
        k.buffer("slot", &batch.slot)?.buffer("kind", &batch.kind)?.buffer("next", &batch.next)?;
        Ok(())
    }

    /// The arguments of `focus` that concern the pupil.
    fn focus_pupil(&self, k: &mut Kernel) -> Result<()> {
        let model = self.model;
        self.poses(k, &self.colours.pose.whole)?;
        k.buffer("place", &model.place)?.int("blocks", self.counts.blocks)?.int("width", self.shape.width)?;
        k.buffer("entry_start", &model.entry_start)?.buffer("entry_segment", &model.entry_segment)?;
        k.buffer("segment_start", &model.segment_start)?.buffer("segment_entry", &model.segment_entry)?;
        k.buffer("entry_place", &model.entry_place)?.buffer("extent", &model.extent)?;
        Ok(())
    }

    /// The further arguments of `focus_stored`.
    fn focus_colours(&self, k: &mut Kernel) -> Result<()> {
        let (colours, scratch) = (self.colours, self.scratch);
        colours.scales.bind(k, "scales")?.int("colours", self.counts.colours)?;
        colours.excess.whole.bind(k, "excess")?;
        scratch.intensity.bind(k, "intensity")?;
        scratch.convolved.bind(k, "convolved")?;
        self.model.terms.bind(k, "term")?.int("terms", self.counts.terms)?;
        for (argument, array) in [
            ("excess_apart", &colours.excess),
            ("pose_apart", &colours.pose),
            ("phasor_apart", &colours.phasor),
            ("focal_apart", &colours.focal),
            ("y_to_v_apart", &colours.y_to_v),
            ("x_to_u_apart", &colours.x_to_u),
            ("u_to_x_apart", &colours.u_to_x),
            ("v_to_y_apart", &colours.v_to_y),
        ] {
            k.int(argument, array.apart)?;
        }
        Ok(())
    }
}
