//! `cophase devices`: list of the devices that an estimate can run on.

use cophase::Result;
use cophase::device;
use cophase_view::terminal::Terminal;
use serde::Serialize;

const EXAMPLES: &str = "Examples:
  cophase devices
  cophase estimate images.fits -o est.fits --device cpu

The first column is what 'cophase estimate --device' takes.";

/// List what an estimate can run on here
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

/// One line of the list.
#[derive(Serialize)]
struct Listed {
    /// As `--device` takes it.
    device: String,
    name: String,
    /// Threads of a CPU, compute units of a device.
    units: usize,
    f64: bool,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let (devices, advice) = list();
    if arguments.json {
        return terminal.json(&devices);
    }
    for Listed { device, name, units, f64 } in &devices {
        let precision = if *f64 { "f32 and f64" } else { "f32" };
        let units = cophase_view::terminal::counted(*units, if device == "cpu" { "thread" } else { "compute unit" });
        terminal.print(&format!("{device:<12}  {name}, {units}, {precision}\n"))?;
    }
    match advice {
        Some(sentence) => terminal.show(&format!("{sentence}\n")),
        None => Ok(()),
    }
}

/// Everything that is here, and what to do where that is little.
fn list() -> (Vec<Listed>, Option<String>) {
    let units = std::thread::available_parallelism().map_or(1, usize::from);
    let mut listed = vec![Listed { device: "cpu".into(), name: processor(), units, f64: true }];
    let present = match device::devices() {
        Ok(present) => present,
        Err(error) => return (listed, Some(error.to_string())),
    };
    listed.extend(present.iter().map(|info| Listed {
        device: info.address(),
        name: format!("{} ({})", info.name.trim(), info.platform_name.trim()),
        units: info.compute_units as usize,
        f64: info.f64,
    }));
    (listed, device::advice(&present))
}

/// What Linux calls the processor; its architecture elsewhere.
fn processor() -> String {
    let table = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = table.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':').map(|(_, name)| name));
    name.map_or_else(|| std::env::consts::ARCH.into(), |name| name.trim().to_string())
}
