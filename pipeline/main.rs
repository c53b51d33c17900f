//! The command `holescout`: parses, calls the library, reports.

mod cli;
mod config;
mod console;
mod diff;
mod evaluate;
mod export;
#[cfg(feature = "torch")]
mod export_policy;
mod failure;
mod import_rsrp;
mod inspect;
mod rasterise;
mod release;
mod scenes;
mod schemas;
mod scores;
mod shard;
mod task;
#[cfg(feature = "torch")]
mod train;
mod verify;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;

use cli::{Cli, Command};
use console::{Console, Report};
use failure::Failure;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return cli::report_usage(&error),
    };
    let console = Console::new(cli.common.quiet);
    match run(&cli, &console).and_then(|report| print(&report, cli.common.json)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_broken_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            console::report_error(&failure);
            failure.exit_code(cli.command.is_task())
        }
    }
}

fn run(cli: &Cli, console: &Console) -> Result<Report, Failure> {
    if let Some(threads) = cli.common.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global();
        pool.map_err(Failure::running)?;
    }
    let config = config::merged(&cli.common, &cli.command)?;
    match &cli.command {
        Command::Rasterise(args) => rasterise::run(args, &config, console),
        Command::Scenes(args) => scenes::run(args, &config, console),
        Command::ImportRsrp(args) => import_rsrp::run(args, &config, console),
        Command::Shard(args) => shard::run(args, &config, console),
        Command::Evaluate(args) => evaluate::run(args, &config, console),
        #[cfg(feature = "torch")]
        Command::Train(args) => train::run(args, &config, console),
        #[cfg(feature = "torch")]
        Command::ExportPolicy(args) => export_policy::run(args),
        Command::Verify(args) => verify::run(args, console),
        Command::Inspect(args) => inspect::run(args, &config),
        Command::Release(args) => release::run(args, console),
        Command::Export(args) => export::run(args, &config, console),
        Command::Diff(args) => diff::run(args, console),
        Command::Schemas(args) => schemas::run(args),
        Command::Config(_) => config::run(&config),
    }
}

/// The report as text, or with `--json` as one line; either way the end of standard output.
fn print(report: &Report, json: bool) -> Result<(), Failure> {
    let mut stdout = std::io::stdout().lock();
    let text = if json { format!("{}\n", report.json) } else { report.text.clone() };
    let printed = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    // What was found out counts also when nobody reads it.
    report.outcome()?;
    printed.map_err(Failure::running)
}
