//! `holescout evaluate`.

use std::fmt::Write;
use std::path::Path;

use holescout::config::{Config, Split};
use holescout::evaluate::{EvaluateJob, Interval, Report as Evaluation, evaluate};
use holescout::progress::Progress;
use holescout::rl::policy::MakePolicy;
use serde_json::json;

use crate::cli::{EvaluateArgs, SplitChoice};
use crate::console::{Console, Report};
use crate::failure::Failure;

pub(crate) fn run(
    args: &EvaluateArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let agent = args.policy.as_deref().map(|policy| load(policy, args, config)).transpose()?;
    let agent = agent.as_ref().map(|(agent, sha256)| (&**agent, &**sha256));
    let job = EvaluateJob {
        dataset: &args.dataset,
        agent,
        split: match args.split {
            SplitChoice::Train => Some(Split::Train),
            SplitChoice::Val => Some(Split::Val),
            SplitChoice::Test => Some(Split::Test),
            SplitChoice::All => None,
        },
        config,
        out: &args.output.out,
        overwrite: args.output.overwrite,
    };
    let report = evaluate(job, console)?;
    let maps = report.maps;
    if maps.overlapping_pairs > 0 {
        console.note(&format!(
            "note: {} pairs of maps share cells, so the intervals are too narrow",
            maps.overlapping_pairs
        ));
    }
    let all_starts = report.scores.iter().filter(|score| score.starts == report.evaluate.starts);
    let summary = json!({
        "stage": "evaluate",
        "split": report.split,
        "maps": maps,
        "scores": all_starts.collect::<Vec<_>>(),
    });
    Report::new(text(&report), &summary)
}

/// A trained policy, and the SHA-256 of its weights.
type Loaded = (Box<dyn MakePolicy>, String);

#[cfg(feature = "torch")]
fn load(policy: &Path, args: &EvaluateArgs, config: &Config) -> Result<Loaded, Failure> {
    use holescout::{dataset::Dataset, rl::agent::Agent, store::sha256_file};
    let device = args.device.choice().device()?;
    let dataset = Dataset::open_with(&args.dataset, &config.remote)?;
    let cells = dataset.manifest().cells as usize;
    let agent = Agent::load(policy, cells, &config.rl, device)?;
    let weights = policy.join("weights.safetensors");
    Ok((Box::new(agent), sha256_file(&weights)?.sha256))
}

#[cfg(not(feature = "torch"))]
fn load(policy: &Path, _: &EvaluateArgs, _: &Config) -> Result<Loaded, Failure> {
    let policy = policy.display();
    Err(Failure::input(format!(
        "{policy}: this program was built without libtorch and knows no trained policies: \
         build it with `make train`, or with the feature torch"
    )))
}

/// Precision and recall with all starts, a line a method.
fn text(report: &Evaluation) -> String {
    let mut text = format!(
        "{} maps, {} starts on each; precision / recall in % after at most k steps\n{:<28}",
        report.maps.evaluated, report.evaluate.starts, "",
    );
    for k in &report.evaluate.steps {
        write!(text, "{:>14}", format!("k = {k}")).expect("writing to a string cannot fail");
    }
    text.push('\n');
    let percent = |value: Option<Interval>| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{:.1}", 100.0 * value.mean))
    };
    for method in &report.methods {
        write!(text, "{:<28}", method.title).expect("writing to a string cannot fail");
        for &k in &report.evaluate.steps {
            let scores = report.score(method.name, k).map_or_else(String::new, |score| {
                format!("{} / {}", percent(score.precision), percent(score.recall))
            });
            write!(text, "{scores:>14}").expect("writing to a string cannot fail");
        }
        text.push('\n');
    }
    text
}
