//! The kernel table: every OpenCL kernel of the project, its source, its work-group size, and the
//! compiler options.

use super::info::{DeviceInfo, DeviceKind};
use super::precision::Precision;

/// The prologue of every program: number types, vector loads, complex helpers.
const COMMON: &str = include_str!("../../kernels/common.cl");

/// One kernel function.
#[derive(Debug)]
pub(crate) struct Entry {
    /// The `__kernel` function.
    pub name: &'static str,
    /// Work-group size on a device that runs work-items in lockstep (a GPU). A CPU uses groups of
    /// one: its kernels are written with explicit vectors, and a larger group would only add a
    /// loop.
    pub gpu_local: [usize; 3],
}

/// One file of `kernels/`.
#[derive(Debug)]
pub(crate) struct Family {
    /// Name of the file in `kernels/`.
    pub file: &'static str,
    /// Its text.
    pub source: &'static str,
    /// Its kernels.
    pub entries: &'static [Entry],
}

/// The table, in the order in which the files are compiled, as one program: `focus.cl` calls
/// functions of the files before it.
pub(crate) const TABLE: &[Family] = &[
    Family {
        file: "field.cl",
        source: include_str!("../../kernels/field.cl"),
        entries: &[
            Entry { name: "smooth_phase", gpu_local: [64, 1, 1] },
            Entry { name: "add_free_phase", gpu_local: [64, 1, 1] },
            Entry { name: "pupil_field", gpu_local: [64, 1, 1] },
        ],
    },
    Family {
        file: "transform.cl",
        source: include_str!("../../kernels/transform.cl"),
        entries: &[
            Entry { name: "forward_columns", gpu_local: [32, 1, 1] },
            Entry { name: "forward_rows", gpu_local: [64, 1, 1] },
            Entry { name: "adjoint_rows", gpu_local: [64, 1, 1] },
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
        file: "intensity.cl",
        source: include_str!("../../kernels/intensity.cl"),
        entries: &[
            Entry { name: "add_intensity", gpu_local: [32, 1, 1] },
            Entry { name: "convolve_rows", gpu_local: [32, 1, 1] },
            Entry { name: "convolve_columns", gpu_local: [32, 1, 1] },
            Entry { name: "intensity_sums", gpu_local: [32, 1, 1] },
            Entry { name: "intensity_residuals", gpu_local: [32, 1, 1] },
            Entry { name: "scale_field", gpu_local: [32, 1, 1] },
        ],
    },
    Family {
        file: "project.cl",
        source: include_str!("../../kernels/project.cl"),
        entries: &[
            Entry { name: "pupil_gradient", gpu_local: [64, 1, 1] },
            Entry { name: "project_modes", gpu_local: [32, 1, 1] },
            Entry { name: "project_segments", gpu_local: [32, 1, 1] },
            Entry { name: "free_phase_gradient", gpu_local: [64, 1, 1] },
            Entry { name: "collect", gpu_local: [32, 1, 1] },
        ],
    },
    Family {
        file: "focus.cl",
        source: include_str!("../../kernels/focus.cl"),
        entries: &[
            Entry { name: "focus", gpu_local: [32, 1, 1] },
            Entry { name: "focus_stored", gpu_local: [32, 1, 1] },
        ],
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

/// Compile-time parameters of a program. Each is a preprocessor definition documented in
/// `common.cl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Build {
    /// Number type.
    pub precision: Precision,
    /// Numbers in one vector: 1, 4, 8 or 16.
    pub vector: usize,
    /// The FFT that replaces the matrix products; `None` for matrix products.
    pub fft: Option<FftPlan>,
}

/// Factorisation of an FFT into two passes of `a` and `b` points, see `fft.cl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct FftPlan {
    /// Points of the small transforms of the first pass.
    pub a: usize,
    /// Points of the small transforms of the second pass.
    pub b: usize,
    /// Blocks of `b` inputs on either side of the axis that are not all zero.
    pub nonzero_blocks: usize,
}

impl FftPlan {
    /// Sizes of the small transforms in `fft.cl`.
    const RADICES: [usize; 5] = [8, 12, 15, 16, 20];

    /// The plan for `points` inputs of which only the `nonzero` next to the axis on either side are
    /// not zero; `None` where `points` is not a product of two radices. Among several plans the one
    /// that reads the fewest zeros, then the one with the most equal factors.
    pub fn new(points: usize, nonzero: usize) -> Option<Self> {
        let plan = |a: usize| Self { a, b: points / a, nonzero_blocks: nonzero.div_ceil(points / a) };
        Self::RADICES
            .into_iter()
            .filter(|a| points.is_multiple_of(*a) && Self::RADICES.contains(&(points / a)))
            .map(plan)
            .filter(|plan| 2 * plan.nonzero_blocks <= plan.a)
            .min_by_key(|plan| (plan.nonzero_blocks * plan.b, plan.a + plan.b, plan.b))
    }

    /// Points of the FFT.
    pub fn points(&self) -> usize {
        self.a * self.b
    }
}

impl Build {
    /// The build for `device`: one number per work-item on a GPU; on a CPU the native vector width,
    /// at least 4, because the kernels are not vectorised across work-items there.
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

    /// Whether work-items run in lockstep with one number each; work-groups then have the size
    /// [`Entry::gpu_local`].
    pub fn is_scalar(&self) -> bool {
        self.vector == 1
    }

    /// Options of the OpenCL compiler. They keep the names of arguments, because arguments are
    /// bound by name.
    pub(super) fn options(&self) -> String {
        let double = usize::from(self.precision == Precision::F64);
        // Without signed zeros x + 0 is x, which prunes the small transforms of zeros.
        let mut options = format!(
            "-cl-std=CL1.2 -cl-kernel-arg-info -cl-mad-enable -cl-no-signed-zeros -DDOUBLE={double} -DVEC={}",
            self.vector
        );
        if let Some(FftPlan { a, b, nonzero_blocks }) = self.fft {
            options += &format!(" -DFFT_A={a} -DFFT_B={b} -DFFT_NONZERO={nonzero_blocks}");
        }
        options
    }
}

/// The text of the program: `common.cl`, then the table. With `#line` a build log refers to lines
/// of the files.
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
