//! Builds the stand-in for libOpenCL that opens the real one at run time (`src/device/loader.c`
//! says why).

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    #[cfg(feature = "opencl")]
    opencl_loader();
}

/// Compiles the loader into `OUT_DIR/libOpenCL.a`. cargo searches `OUT_DIR` before the system's
/// folders, so that the `-lOpenCL` of `cl-sys` finds this archive whether or not the machine has
/// the library too; linking it as `static` from here as well puts it into our own staticlib. macOS
/// links its OpenCL framework and Windows needs a vendor's import library: both stay as `cl-sys`
/// has them.
#[cfg(feature = "opencl")]
fn opencl_loader() {
    println!("cargo:rerun-if-changed=src/device/loader.c");
    println!("cargo:rerun-if-changed=src/device/loader_table.h");
    println!("cargo:rerun-if-changed=src/device/probe.c");
    let unix = std::env::var("CARGO_CFG_TARGET_FAMILY").is_ok_and(|family| family.split(',').any(|f| f == "unix"));
    let macos = std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "macos");
    if unix && !macos {
        cc::Build::new()
            .file("src/device/loader.c")
            .file("src/device/probe.c")
            .flag_if_supported("-fvisibility=hidden")
            .warnings(true)
            .extra_warnings(true)
            .compile("OpenCL");
    }
}
