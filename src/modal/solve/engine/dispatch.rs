//! Choice of the engine for a chain.

use crate::Result;
use crate::imaging::Chain;
use crate::modal::solve::engine::cpu::CpuEngine;
use crate::modal::solve::engine::device::DeviceEngine;
use crate::modal::solve::engine::paper;
use crate::modal::solve::engine::several;
use crate::modal::solve::engine::task::{Engine, FitTask, ImageFit, Prepare};
use crate::scene::Optimizer;

/// Fits images on `chain`, in memory that is taken for this call.
///
/// # Errors
/// As [`Engine::fit`].
pub(in crate::modal) fn fit(
    chain: &mut Chain,
    task: &FitTask,
    prepare: &Prepare,
    images: &mut [ImageFit],
) -> Result<()> {
    if task.recipe.optimizer == Optimizer::Bfgs {
        return paper::fit(chain, task, prepare, images);
    }
    match chain.active_chain() {
        Chain::Cpu32(chain) => CpuEngine::new(&*chain, None).fit(task, prepare, images),
        Chain::Cpu64(chain) => CpuEngine::new(&*chain, None).fit(task, prepare, images),
        Chain::Several(group) => several::fit(group, task, prepare, images),
        device => DeviceEngine::new(device).fit(task, prepare, images),
    }
}
