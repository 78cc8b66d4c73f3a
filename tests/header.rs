//! The headers in `include` are what cbindgen makes of src/capi, and compile as C89, C99 and C++17;
//! the reference of a scene's keys beside them is what `cophase scene --reference` prints.

#[path = "common/libraries.rs"]
mod libraries;

use libraries::libraries;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Declarations of one file of src/capi.
fn declarations(file: &str) -> String {
    let config = cbindgen::Config::from_file(root().join("cbindgen.toml")).unwrap();
    let builder = cbindgen::Builder::new().with_config(config).with_src(root().join("src/capi").join(file));
    let mut made = Vec::new();
    builder.generate().unwrap().write(&mut made);
    format!("{}\n\n", comments(String::from_utf8(made).unwrap().trim()))
}

/// Comments in one line where they have one, else with an asterisk before each line.
fn comments(declarations: &str) -> String {
    let mut made = Vec::new();
    let mut lines = declarations.lines();
    while let Some(line) = lines.next() {
        let Some(indent) = line.strip_suffix("/*") else {
            made.push(line.to_string());
            continue;
        };
        let text: Vec<&str> = lines.by_ref().take_while(|line| line.trim() != "*/").collect();
        let text: Vec<&str> = text.iter().map(|line| line.strip_prefix(&format!("{indent} ")).unwrap_or("")).collect();
        if let [only] = text[..] {
            made.push(format!("{indent}/* {only} */"));
            continue;
        }
        let starred =
            |(place, line): (usize, &&str)| format!("{indent}{} {line}", if place == 0 { "/*" } else { " *" });
        made.extend(text.iter().enumerate().map(|line| starred(line).trim_end().to_string()));
        made.push(format!("{indent} */"));
    }
    made.join("\n")
}

/// A template of src/capi, with declarations in place of the lines `@file.rs@`.
fn header(name: &str) -> String {
    let template = std::fs::read_to_string(root().join("src/capi").join(format!("{name}.in"))).unwrap();
    let line = |line: &str| match line.strip_prefix('@').and_then(|line| line.strip_suffix('@')) {
        Some(file) => declarations(file),
        None => format!("{line}\n"),
    };
    template.lines().map(line).collect()
}

#[test]
fn the_headers_are_up_to_date() {
    for name in ["cophase.h", "cophase_simulator.h"] {
        let (path, made) = (root().join("include").join(name), header(name));
        if std::env::var_os("COPHASE_BLESS").is_some() {
            std::fs::write(&path, &made).unwrap();
        }
        let there = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(there == made, "include/{name} is old: run COPHASE_BLESS=1 cargo test --test header");
    }
}

#[test]
fn the_reference_of_a_scene_is_up_to_date() {
    let (path, made) = (root().join("include/scene-reference.txt"), cophase::scene::reference());
    if std::env::var_os("COPHASE_BLESS").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    let there = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(there == made, "include/scene-reference.txt is old: run COPHASE_BLESS=1 cargo test --test header");
}

/// Every function of src/capi is in a header, and no function or type twice: an object is declared
/// before it is used.
#[test]
fn the_headers_have_every_function_once() {
    let headers = ["cophase.h", "cophase_simulator.h"].map(header).concat();
    let mut functions = 0;
    for entry in std::fs::read_dir(root().join("src/capi")).unwrap() {
        let path = entry.unwrap().path();
        let source = std::fs::read_to_string(&path).unwrap();
        for line in source.lines().filter(|line| line.starts_with("pub ") && line.contains("extern \"C\" fn ")) {
            let name = line.split("fn ").nth(1).unwrap().split('(').next().unwrap();
            let declared = headers.lines().filter(|line| !line.starts_with(' ') && line.contains(&format!("{name}(")));
            assert_eq!(declared.count(), 1, "{name}");
            functions += 1;
        }
    }
    println!("{functions} functions");
}

#[test]
fn the_headers_compile_as_c_and_as_cpp() {
    let directory = tempfile::tempdir().unwrap();
    for (compiler, standard, name) in
        [("cc", "-std=c89", "old.c"), ("cc", "-std=c99", "use.c"), ("c++", "-std=c++17", "use.cpp")]
    {
        let source = directory.path().join(name);
        let options = match name {
            "old.c" => "{0}",
            "use.c" => "{.struct_size = sizeof options}",
            _ => "{}",
        };
        // A compiler's warning on fields without a value is about this program in C89, not about
        // the header.
        let quiet = if name == "old.c" { "-Wno-missing-field-initializers" } else { "-Wall" };
        let program = format!(
            "#include <cophase_simulator.h>\n#include <cophase.h>\nint main(void)\n{{\n    cophase_fit_options options = \
             {options};\n    cophase_input frames;\n    frames = cophase_input_from_array(0, COPHASE_F32, 1, 2, 3);\n    \
             return cophase_version() == 0 || options.start_nm != 0 || frames.rows != 2;\n}}\n"
        );
        std::fs::write(&source, program).unwrap();
        let output = Command::new(compiler)
            .args([
                standard,
                "-Wall",
                "-Wextra",
                "-Wpedantic",
                "-pedantic-errors",
                "-Werror",
                quiet,
                "-fsyntax-only",
                "-I",
            ])
            .arg(root().join("include"))
            .arg(&source)
            .output();
        match output {
            Ok(output) => {
                assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
            }
            Err(error) if compiler == "c++" => println!("skipped: no C++ compiler here ({error})"),
            Err(error) => panic!("{compiler}: {error}"),
        }
    }
}

#[test]
fn names_and_versions_are_readable_from_c() {
    let text = |pointer| unsafe { std::ffi::CStr::from_ptr(pointer) }.to_str().unwrap().to_string();
    assert_eq!(text(cophase::capi::cophase_version()), env!("CARGO_PKG_VERSION"));
    assert_eq!(text(cophase::capi::cophase_status_name(0)), "OK");
    assert_eq!(text(cophase::capi::cophase_status_name(cophase::Error::Shape(String::new()).status())), "BAD_SHAPE");
    assert_eq!(text(cophase::capi::cophase_status_name(-7)), "UNKNOWN");
}

#[test]
fn a_c_program_links_and_runs() {
    let libraries = libraries();
    let directory = tempfile::tempdir().unwrap();
    let program = directory.path().join("versions");
    let output = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(root().join("include"))
        .arg(root().join("bindings/c/versions.c"))
        .arg("-L")
        .arg(&libraries)
        .arg("-lcophase")
        .arg(format!("-Wl,-rpath,{}", libraries.display()))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // cargo's own search path begins with a folder where an older library may lie.
    let output = Command::new(&program).env("LD_LIBRARY_PATH", &libraries).output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with(&format!("cophase {}, C interface", env!("CARGO_PKG_VERSION"))), "{text}");
    assert!(text.contains("0 OK\n1 BAD_SCENE\n") && text.contains("11 PANIC\n12 UNKNOWN\n"), "{text}");
    assert!(
        text.contains("100 OK\n101 MISFIT\n") && text.contains("105 DEADLINE\n106 CONTRADICTORY\n107 UNKNOWN\n"),
        "{text}"
    );
}
