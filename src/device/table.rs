//! The kernel table: every OpenCL kernel of the project, its source, and how it is built and launched, as data.

use super::{DeviceInfo, DeviceKind, Precision};

/// The prologue of every program: number types, vector loads, complex helpers.
const COMMON: &str = include_str!("../../kernels/common.cl");

/// One kernel function.
#[derive(Debug)]
pub struct Entry {
    /// The `__kernel` function.
    pub name: &'static str,
    /// Work-group size on a device that runs work-items in lockstep. A processor gets groups of one: its kernels are
    /// written in explicit vectors, and a group only costs it a loop.
    pub gpu_local: [usize; 3],
}

/// One file of `kernels/`.
#[derive(Debug)]
pub struct Family {
    /// Name of the file in `kernels/`.
    pub file: &'static str,
    /// Its text.
    pub source: &'static str,
    /// Its kernels.
    pub entries: &'static [Entry],
}

/// The table, in the order in which the files are compiled: as one program, for `focus.cl` calls functions of the files
/// before it.
pub const TABLE: &[Family] = &[
    Family {
        file: "field.cl",
        source: include_str!("../../kernels/field.cl"),
        entries: &[
            Entry { name: "smooth_phase", gpu_local: [64, 1, 1] },
            Entry { name: "add_free", gpu_local: [64, 1, 1] },
            Entry { name: "pupil_field", gpu_local: [64, 1, 1] },
        ],
    },
    Family {
        file: "transform.cl",
        source: include_str!("../../kernels/transform.cl"),
        entries: &[
            Entry { name: "forward_columns", gpu_local: [32, 1, 1] },
            Entry { name: "forward_rows", gpu_local: [32, 1, 1] },
            Entry { name: "adjoint_rows", gpu_local: [32, 1, 1] },
            Entry { name: "adjoint_columns", gpu_local: [32, 1, 1] },
        ],
    },
    Family {
        file: "pixels.cl",
        source: include_str!("../../kernels/pixels.cl"),
        entries: &[
            Entry { name: "photometry_sums", gpu_local: [32, 1, 1] },
            Entry { name: "photometry_solve", gpu_local: [32, 1, 1] },
            Entry { name: "residuals", gpu_local: [32, 1, 1] },
        ],
    },
    Family {
        file: "project.cl",
        source: include_str!("../../kernels/project.cl"),
        entries: &[
            Entry { name: "pupil_gradient", gpu_local: [64, 1, 1] },
            Entry { name: "project_modes", gpu_local: [32, 1, 1] },
            Entry { name: "project_segments", gpu_local: [32, 1, 1] },
            Entry { name: "take_free", gpu_local: [64, 1, 1] },
            Entry { name: "collect", gpu_local: [32, 1, 1] },
        ],
    },
    Family {
        file: "focus.cl",
        source: include_str!("../../kernels/focus.cl"),
        entries: &[Entry { name: "focus", gpu_local: [32, 1, 1] }],
    },
    Family {
        file: "peak.cl",
        source: include_str!("../../kernels/peak.cl"),
        entries: &[
            Entry { name: "peak_flops", gpu_local: [64, 1, 1] },
            Entry { name: "peak_read", gpu_local: [64, 1, 1] },
        ],
    },
    Family {
        file: "fft.cl",
        source: include_str!("../../kernels/fft.cl"),
        entries: &[Entry { name: "focus_fft", gpu_local: [1, 1, 1] }],
    },
];

/// How a program is specialised. Every knob is a preprocessor definition that `common.cl` documents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Build {
    /// Number type.
    pub precision: Precision,
    /// Numbers in one vector: 1, 4, 8 or 16.
    pub vector: usize,
    /// The FFT that stands in for the matrix products, where there is one.
    pub fft: Option<FftPlan>,
}

/// An FFT of a x b points in two passes, as `fft.cl` documents it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FftPlan {
    /// Points of the small transforms of the first pass.
    pub a: usize,
    /// Points of those of the second.
    pub b: usize,
    /// Blocks of b inputs that are not zero, on either side of the axis.
    pub lit: usize,
}

impl FftPlan {
    /// What `fft.cl` has small transforms for.
    const RADICES: [usize; 5] = [8, 12, 15, 16, 20];

    /// A plan for `points` of which the `lit_samples` next to the axis on either side are not zero; `None` where `points`
    /// is no product of two radices. Of several the one that reads fewest zeros, then the most even one.
    pub fn new(points: usize, lit_samples: usize) -> Option<Self> {
        let plan = |a: usize| Self { a, b: points / a, lit: lit_samples.div_ceil(points / a) };
        Self::RADICES
            .into_iter()
            .filter(|a| points.is_multiple_of(*a) && Self::RADICES.contains(&(points / a)))
            .map(plan)
            .filter(|plan| 2 * plan.lit <= plan.a)
            .min_by_key(|plan| (plan.lit * plan.b, plan.a + plan.b, plan.b))
    }

    /// Its points.
    pub fn points(&self) -> usize {
        self.a * self.b
    }
}

impl Build {
    /// The build that suits `device`: one number per work-item on a GPU; on a processor the native vector, and no less
    /// than 4, because the kernels there are not vectorised across work-items.
    pub fn for_device(device: &DeviceInfo, precision: Precision) -> Self {
        let single = match device.kind {
            DeviceKind::Gpu | DeviceKind::Accelerator => 1,
            DeviceKind::Cpu => match device.vector_f32 {
                16.. => 16,
                8..16 => 8,
                _ => 4,
            },
        };
        let vector = match precision {
            Precision::F32 => single,
            Precision::F64 if single > 4 => single / 2,
            Precision::F64 => single,
        };
        Self { precision, vector, fft: None }
    }

    /// Whether work-items run in lockstep, one number each: then work-groups are [`Entry::gpu_local`].
    pub fn is_scalar(&self) -> bool {
        self.vector == 1
    }

    /// Options of the OpenCL compiler. Argument names are kept because arguments are bound by name.
    pub(super) fn options(&self) -> String {
        let double = usize::from(self.precision == Precision::F64);
        // Zeros have no sign here: x + 0 is x, which prunes the small transforms of zeros.
        let mut options = format!(
            "-cl-std=CL1.2 -cl-kernel-arg-info -cl-mad-enable -cl-no-signed-zeros -DDOUBLE={double} -DVEC={}",
            self.vector
        );
        if let Some(FftPlan { a, b, lit }) = self.fft {
            options += &format!(" -DFFT_A={a} -DFFT_B={b} -DFFT_LIT={lit}");
        }
        options
    }
}

/// The text of the program: `common.cl`, then the table. `#line` lets a build log name the line of the file itself.
pub(super) fn program_text() -> String {
    let mut text = String::from(COMMON);
    for family in TABLE {
        text += &format!("\n#line 1 \"{}\"\n{}", family.file, family.source);
    }
    text
}

/// The entry of kernel `name`.
pub(super) fn find(name: &str) -> Option<&'static Entry> {
    TABLE.iter().flat_map(|family| family.entries).find(|entry| entry.name == name)
}
