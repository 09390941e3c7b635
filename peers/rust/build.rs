//! Builds the C library of ../c with make, and takes the crate's constants from its header.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    let library = out.join("libhapticnet_binding.a");
    let made = Command::new("make")
        .args(["-s", "-C", "../c", "CFLAGS=-O2 -fPIC"])
        .arg(format!("BUILD={}", out.display()))
        .arg(&library)
        .status()
        .expect("make must be installed");
    assert!(made.success(), "the C library in ../c does not build; see the lines above");

    let header = fs::read_to_string("../c/include/hapticnet_constants.h").expect("../c/include must be there");
    let constant = |name: &str| {
        let line = header.lines().find(|line| line.starts_with(&format!("#define HN_{} ", name)));
        let value = line.and_then(|line| line.rsplit(' ').next()).expect("the header has this constant");
        format!("/// As the C library has it.\npub const {}: usize = {};\n", name, value)
    };
    let constants = constant("DATAGRAM_BYTES") + &constant("MOST_AXES");
    fs::write(out.join("constants.rs"), constants).expect("OUT_DIR can be written");

    println!("cargo:rustc-link-search=native={}", out.display());
    println!("cargo:rustc-link-lib=static=hapticnet_binding");
    println!("cargo:rustc-link-lib=crypto");
    for folder in ["include", "src", "sealed", "shared"] {
        println!("cargo:rerun-if-changed={}", Path::new("../c").join(folder).display());
    }
}
