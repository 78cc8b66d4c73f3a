//! Maximum a posteriori (MAP) wavefront retrieval: the whole wavefront behind one image, under a
//! prior power spectral density.
//!
//! ```text
//! power spectral density ─ spectral preconditioner ┐                          ┌ CPU: an image a thread
//! frame ─ prepare ─ weights ─ information ─────────┴ χ² + prior ─ quasi-Newton ┤
//! static wavefront about which it is sought ────────┘                         └ device: a batch in lock-step
//! ```

mod ao_residual;
mod cpu_worker;
mod device_batch;
mod engine;
mod exposure_blur;
mod illuminated_samples;
mod information_probe;
mod model;
mod optics_estimate;
mod optics_parameter;
mod optics_search;
mod optimisation;
mod preconditioner;
mod prior;
mod results;
mod retriever;
mod sampling;
mod segment_amplitudes;
mod settings;
mod static_wavefront;
mod task;
mod workspace;

pub use illuminated_samples::IlluminatedSamples;
pub use optics_estimate::RetrievedOptics;
pub(crate) use optics_search::{OPTICS_SEARCH_CHI2, estimate_optics};
pub use prior::{RadialPsd, StaticAberrationRms};
pub use results::{RetrievalReport, RetrievedWavefronts};
pub use retriever::Retriever;
pub use settings::RetrievalSettings;
pub use static_wavefront::StaticWavefront;

#[cfg(test)]
pub(crate) mod tests;
