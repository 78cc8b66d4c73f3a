//! Full-phase retrieval, and static errors from a sequence of phases.

mod precondition;
mod prior;
mod retrieve;
mod worker;

pub use prior::{Spectrum, Unknown};
pub use retrieve::{Phases, RetrievalRecipe, RetrievalReport, Retriever, Statics};

#[cfg(test)]
mod tests;
