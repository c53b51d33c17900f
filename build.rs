//! Tells the linker where libtorch is, for programs with the feature `torch`.

fn main() {
    println!("cargo::rerun-if-env-changed=LIBTORCH");
    let is_set = |name| std::env::var_os(name).is_some();
    // Documentation is not linked.
    if !is_set("CARGO_FEATURE_TORCH") || is_set("DOCS_RS") {
        return;
    }
    let Ok(libtorch) = std::env::var("LIBTORCH") else {
        println!(
            "cargo::error=the feature torch needs libtorch: run `make libtorch`, and set LIBTORCH to .libtorch"
        );
        return;
    };
    println!("cargo::rustc-link-arg=-Wl,-rpath,{libtorch}/lib");
    // libtorch_cpu.so mentions libraries of CUDA that a CPU never loads.
    println!("cargo::rustc-link-arg=-Wl,--allow-shlib-undefined");
}
