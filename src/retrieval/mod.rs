//! Maximum a posteriori (MAP) wavefront retrieval: the whole wavefront behind one image, under a prior power spectral density.
//!
//! ```text
//! power spectral density ─ spectral preconditioner ┐                          ┌ CPU: an image a thread
//! frame ─ prepare ─ weights ─ information ─────────┴ χ² + prior ─ quasi-Newton ┤
//! static wavefront about which it is sought ────────┘                         └ device: a batch in lock-step
//! ```

mod cpu_worker;
mod device_batch;
mod engine;
mod illuminated_samples;
mod information_probe;
mod optics_estimate;
mod optics_search;
mod optimisation;
mod preconditioner;
mod prior;
mod results;
mod retriever;
mod sampling;
mod segment_amplitudes;

pub use illuminated_samples::LitSamples;
pub use optics_estimate::OpticsFound;
pub(crate) use optics_search::{CALLS, found};
pub use prior::{Spectrum, Unknown};
pub use results::{Phases, RetrievalReport};
pub use retriever::{RetrievalRecipe, Retriever, Statics};

#[cfg(test)]
pub(crate) mod tests;
