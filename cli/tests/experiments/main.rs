//! The pictures and the experiments, run in this process.

mod hard_cases;
mod leak;
mod metrics;
mod night_table;
mod paper;
mod plot;
