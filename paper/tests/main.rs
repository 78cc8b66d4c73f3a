//! The pictures and the experiments, run in this process.

mod channels;
mod hard_cases;
mod leak;
mod metrics;
mod night_table;
mod numbering;
mod paper;
mod plot;
mod pulls;
mod pyramid;
mod ticks;
