//! What can be reproduced: the names, and running one of them.

use super::figures::{self, LeakCase};
use super::on_sky_table::all_rows;
use super::{
    ChannelRow, CheckRow, FaultRow, GroupRow, HardCase, LeftOutRow, MovingRow, Options, Progress, PullRow,
    PyramidParts, Report, WavefrontRow, artificial_source, bad_pixels, beyond, beyond_rows, channels, checks,
    closed_loop, diversity, faults, groups, hard_cases, image_numbers, left_out, moving_star, night, observations,
    on_sky, one_wavefront, petals, pulls, pyramid, samples,
};
use cophase::pipeline::Control;
use cophase::pipeline::Part;
use cophase::{Error, Result};
use std::path::Path;

/// What can be reproduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// Section 3: residuals from one image of an artificial source.
    ArtificialSource,
    /// Error against pupil samples and against the width of the fitted image.
    Samples,
    /// Section 3.5: residual against the amplitude of the defocus.
    Diversity,
    /// Table 2: residuals from 200 images behind each kind of loop.
    Table,
    /// Section 4.4: residual against the number of images.
    Images,
    /// Section 4: the layers of turbulence, the segments, the NCPA and the mask.
    Layers,
    /// Section 4: the loop closed on the segments' errors alone.
    Leak,
    /// Section 4.3: modes and maps estimated behind the paper's best loop.
    Modes,
    /// Section 4.5: H-band Strehl ratio before and after the segments are corrected.
    Strehl,
    /// Section 4.5: power spectra of the residual wavefront before and after.
    Psd,
    /// Beyond the paper: the full-phase estimate behind each kind of loop.
    Beyond,
    /// What goes wrong, and whether the answer says so.
    HardCases,
    /// Faults of all kinds that no scene has.
    Faults,
    /// Pixels that are bad and not marked.
    BadPixels,
    /// Images that are fitted together.
    Groups,
    /// Images of one wavefront, and some of another.
    OneWavefront,
    /// Residual over error bar against brightness and number of images.
    Pulls,
    /// What a scene leaves out, with the step that marginalises it and without.
    LeftOut,
    /// Several images of one wavefront: pairs and colours.
    Channels,
    /// One planted fault each: is the right cause named first?
    Checks,
    /// Observations that were planned.
    Observations,
    /// A night that is tracked: drift, jumps, clouds, bad frames.
    Night,
    /// Nights in which star, focus and flux move: false alarms.
    MovingStar,
    /// Estimate, correct, repeat, behind a loop.
    ClosedLoop,
    /// Pistons of the parts of a pupil behind a spider.
    Petals,
    /// The paper's table behind a pyramid sensor.
    Pyramid,
}

impl Target {
    /// All of them.
    pub const ALL: [Target; 26] = [
        Target::ArtificialSource,
        Target::Samples,
        Target::Diversity,
        Target::Table,
        Target::Images,
        Target::Layers,
        Target::Leak,
        Target::Modes,
        Target::Strehl,
        Target::Psd,
        Target::Beyond,
        Target::HardCases,
        Target::Faults,
        Target::BadPixels,
        Target::Groups,
        Target::OneWavefront,
        Target::Pulls,
        Target::LeftOut,
        Target::Channels,
        Target::Checks,
        Target::Observations,
        Target::Night,
        Target::MovingStar,
        Target::ClosedLoop,
        Target::Petals,
        Target::Pyramid,
    ];

    /// The figures of section 4 that are neither the table's nor that of the number of images.
    pub const FIGURES: [Target; 5] = [Target::Layers, Target::Leak, Target::Modes, Target::Strehl, Target::Psd];

    /// The name on the command line, and of its files.
    pub fn name(self) -> &'static str {
        match self {
            Target::ArtificialSource => "artificial-source",
            Target::Samples => "samples",
            Target::Diversity => "diversity",
            Target::Table => "table",
            Target::Images => "images",
            Target::Layers => "layers",
            Target::Leak => "leak",
            Target::Modes => "modes",
            Target::Strehl => "strehl",
            Target::Psd => "psd",
            Target::Beyond => "beyond",
            Target::HardCases => "hard-cases",
            Target::Faults => "faults",
            Target::BadPixels => "bad-pixels",
            Target::Groups => "groups",
            Target::OneWavefront => "one-wavefront",
            Target::Pulls => "pulls",
            Target::LeftOut => "left-out",
            Target::Channels => "channels",
            Target::Checks => "checks",
            Target::Observations => "observations",
            Target::Night => "night",
            Target::MovingStar => "moving-star",
            Target::ClosedLoop => "closed-loop",
            Target::Petals => "petals",
            Target::Pyramid => "pyramid",
        }
    }

    /// One line on what it shows.
    pub fn about(self) -> &'static str {
        match self {
            Target::ArtificialSource => {
                "residuals from one image: the paper's way and ours, against the Cramér-Rao bound"
            }
            Target::Samples => "error and time against pupil samples and the width of the fitted image",
            Target::Diversity => "residual against the amplitude of the defocus at 1640 and 2168.6 nm",
            Target::Table => "the paper's Table 2: a minute of images behind each kind of AO loop",
            Target::Images => "residual against the number of images, mean and median",
            Target::Layers => "what goes in: turbulent layers, segments, NCPA, mask",
            Target::Leak => "segment pistons that leak into the mirror of three loops, without turbulence",
            Target::Modes => "modes and maps estimated behind the masked, inpainted, pseudo-open loop",
            Target::Strehl => "H-band Strehl ratio and PSF before and after the segments are corrected, 64 and 128 nm",
            Target::Psd => "power spectra of the residual wavefront before and after, 64 and 128 nm",
            Target::Beyond => {
                "full-phase estimates behind a loop, beside the paper's way; draws that are there are kept"
            }
            Target::HardCases => "hard cases: is the answer right, and where it is not, does it say so?",
            Target::Faults => "faults of 44 kinds that the scene does not have: within the error bars, or is it said?",
            Target::BadPixels => {
                "hot and dead pixels and cosmic rays that are not marked: residual over the bound of the good pixels"
            }
            Target::Groups => {
                "images in focus with shapes of a mirror, weak defocus: fitted together, is the minimum the right one?"
            }
            Target::OneWavefront => {
                "images of one wavefront, clean or with some of another: how often flagged, and is it said?"
            }
            Target::Pulls => {
                "residual over error bar against brightness and number of images: are the error bars right?"
            }
            Target::LeftOut => {
                "tilts, figures, camera that the scene leaves out: residual over error bar, marginalised and not"
            }
            Target::Channels => "pairs of defocused images, two colours: residuals, error bars, whole wavelengths",
            Target::Checks => "one planted fault each: does 'cophase check' name the right cause first?",
            Target::Observations => "observations as planned: expected and measured errors of 20 random scenes",
            Target::Night => {
                "a night of images every 10 s: tracked and single errors, jumps that are named, false alarms"
            }
            Target::MovingStar => {
                "nights in which star, focus and flux move: false alarms of the wavefront, steps that are named"
            }
            Target::ClosedLoop => {
                "three rounds of images and corrections behind the zonal loop, and the Strehl ratio in K"
            }
            Target::Petals => {
                "pistons of petals up to 800 nm: residual and error bar in focus, out of focus and in two colours"
            }
            Target::Pyramid => "the paper's table behind a pyramid sensor, and the leak of segments into its mirror",
        }
    }

    /// Draws at each point unless the caller names a number: enough for the mean residual to be
    /// known to 10 % (the paper's way scatters by 40 % from draw to draw), and for a quarter of an
    /// hour on two cores; behind a loop 3, which scatter by some 10 %, for six minutes.
    pub fn default_seeds(self) -> usize {
        match self {
            Target::ArtificialSource | Target::Pulls | Target::Channels | Target::LeftOut => 24,
            Target::BadPixels | Target::Groups | Target::OneWavefront => 20,
            Target::Samples | Target::HardCases | Target::Observations | Target::Checks | Target::Petals => 8,
            Target::Diversity => 6,
            // Of 670 rows.
            Target::Faults => 2,
            // Nights without jumps, for the false alarms: 50 of one each are known to 14 %.
            Target::Night | Target::MovingStar => 50,
            Target::Table | Target::Images | Target::ClosedLoop | Target::Pyramid => 3,
            // Half a minute each on two cores; --seeds 10 goes on from there.
            Target::Beyond => 3,
            // The prototype's number; a loop without turbulence is settled in a moment.
            Target::Leak => 12,
            // One draw is what the picture shows.
            Target::Layers | Target::Modes | Target::Strehl | Target::Psd => 1,
        }
    }

    /// The target of that name.
    ///
    /// # Errors
    /// [`Error::Value`] for any other name.
    pub fn parse(name: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|target| target.name() == name).ok_or_else(|| {
            let known = Self::ALL.map(Target::name).join(", ");
            Error::Value(format!("nothing called '{name:.60}' can be reproduced: {known} are accepted"))
        })
    }

    /// Runs it and writes `<name>.csv` and `<name>.png` (and what else the report names) into the
    /// directory.
    ///
    /// `watch` is called with (done, total) in units of fitted images, from any thread.
    ///
    /// # Errors
    /// [`Error::Value`] for no seeds, [`Error::File`] where a file cannot be written,
    /// [`Error::Interrupted`] where `control` was cancelled, and those of the estimator.
    pub fn run(self, options: &Options, watch: &(dyn Fn(usize, usize) + Sync), control: &Control) -> Result<Report> {
        let seeds = options.seeds.unwrap_or(if options.quick { 2 } else { self.default_seeds() });
        if seeds == 0 {
            return Err(Error::Value("--seeds is 0: 1 or more is accepted".into()));
        }
        self.check_part(options.part)?;
        std::fs::create_dir_all(&options.directory).map_err(|error| Error::file(&options.directory, error))?;
        let progress = Progress::new(watch, control);
        let progress = match self.is_shared() {
            true => progress.with_shares(options.shares(self.name())?),
            false => progress,
        };
        self.report(seeds, options, &progress)
    }

    /// Whether processes can share it: its draws do not depend on each other, and each is a few
    /// numbers. Those of beyond have a file of their own.
    fn is_shared(self) -> bool {
        !matches!(
            self,
            Target::Layers
                | Target::Leak
                | Target::Modes
                | Target::Strehl
                | Target::Psd
                | Target::Night
                | Target::MovingStar
                | Target::Petals
                | Target::Groups
                | Target::OneWavefront
                | Target::Beyond
        )
    }

    /// # Errors
    /// [`Error::Value`] for a part of a target that has none.
    pub fn check_part(self, part: Option<Part>) -> Result<()> {
        let is_whole = |target: &Self| !target.is_shared() && *target != Target::Beyond;
        let Some(part) = part.filter(|_| is_whole(&self)) else { return Ok(()) };
        let (name, whole) = (self.name(), Self::ALL.into_iter().filter(is_whole).map(Self::name).collect::<Vec<_>>());
        Err(Error::Value(format!(
            "part {part} of {name}: {} are made by one process; leave --part out, or name another target",
            whole.join(", ")
        )))
    }

    /// Makes its draws, and writes the tables and pictures of all.
    fn report(self, seeds: usize, options: &Options, progress: &Progress) -> Result<Report> {
        let (conditions, quick, rows) = (&options.conditions(), options.quick, &options.rows);
        let run = Run { target: self, options, progress };
        match self {
            Target::ArtificialSource => run.end(artificial_source(seeds, progress)?, |found, to| found.report(to)),
            Target::Samples => run.end(samples(seeds, quick, progress)?, |found, to| found.report(to)),
            Target::Diversity => run.end(diversity(seeds, quick, progress)?, |found, to| found.report(to)),
            Target::Table => run.end(on_sky(&all_rows(), conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::Images => run.end(image_numbers(conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::Layers => run.end(figures::layers(conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::Leak => run.end(figures::leak(&LeakCase::ALL, seeds, progress)?, |found, to| found.report(to)),
            Target::Modes => run.end(figures::modes(conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::Strehl => run.end(figures::strehl(conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::Psd => run.end(figures::psd(conditions, seeds, progress)?, |found, to| found.report(to)),
            Target::HardCases => {
                run.end(hard_cases(&HardCase::named(rows)?, seeds, progress)?, |found, to| found.report(to))
            }
            Target::Faults => run.end(faults(&FaultRow::named(rows)?, seeds, progress)?, |found, to| found.report(to)),
            Target::BadPixels => run.end(bad_pixels(seeds, quick, progress)?, |found, to| found.report(to)),
            Target::Groups => {
                let found = groups(&GroupRow::named(rows)?, seeds, &options.directory, progress)?;
                run.end(found, |found, to| found.report(to))
            }
            Target::OneWavefront => {
                let found = one_wavefront(&WavefrontRow::named(rows)?, seeds, &options.directory, progress)?;
                run.end(found, |found, to| found.report(to))
            }
            Target::Pulls => run.end(pulls(&PullRow::named(rows)?, seeds, progress)?, |found, to| found.report(to)),
            Target::LeftOut => {
                run.end(left_out(&LeftOutRow::named(rows)?, seeds, progress)?, |found, to| found.report(to))
            }
            Target::Channels => {
                run.end(channels(&ChannelRow::named(rows)?, seeds, progress)?, |found, to| found.report(to))
            }
            Target::Checks => run.end(checks(&CheckRow::named(rows)?, seeds, progress)?, |found, to| found.report(to)),
            Target::Observations => run.end(observations(seeds, progress)?, |found, to| found.report(to)),
            Target::Night => run.end(night(seeds, quick, progress)?, |found, to| found.report(to)),
            Target::MovingStar => {
                run.end(moving_star(&MovingRow::named(rows)?, seeds, quick, progress)?, |found, to| found.report(to))
            }
            Target::ClosedLoop => run.end(closed_loop(seeds, progress)?, |found, to| found.report(to)),
            Target::Petals => run.end(petals(seeds, quick, progress)?, |found, to| found.report(to)),
            Target::Pyramid => {
                let parts = PyramidParts::named(rows, quick)?;
                run.end(pyramid(&parts, conditions, seeds, quick, progress)?, |found, to| found.report(to))
            }
            Target::Beyond => {
                let (rows, maps) = beyond_rows(options)?;
                let directory = &options.directory;
                let table = beyond(&rows, conditions, seeds, (directory, options.part), progress)?;
                match options.part {
                    None => table.report(&maps, directory),
                    Some(part) => Ok(table.report_of_part(part, directory)),
                }
            }
        }
    }
}

/// One run of a target.
struct Run<'a> {
    target: Target,
    options: &'a Options,
    progress: &'a Progress<'a>,
}

impl Run<'_> {
    /// The report that `write` makes of all that was found; draws of a part are kept, and make no
    /// table.
    fn end<T>(&self, found: T, write: impl FnOnce(T, &Path) -> Result<Report>) -> Result<Report> {
        let Some((part, shares)) = self.options.part.zip(self.progress.shares()) else {
            return write(found, &self.options.directory);
        };
        let name = self.target.name();
        let text = format!("part {part} of {name}: its draws are kept; without --part the table is made of all\n");
        Ok(Report { text, files: shares.file().filter(|file| file.exists()).map(Path::to_owned).into_iter().collect() })
    }
}
