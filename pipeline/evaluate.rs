//! `holescout evaluate`.

use std::path::Path;

use holescout::config::{Config, EvaluateConfig, Method, Split};
use holescout::evaluate::{EvaluateError, EvaluateJob, evaluate};
use holescout::progress::Progress;
use holescout::rl::policy::MakePolicy;
use serde_json::json;

use crate::cli::{EvaluateArgs, SplitChoice};
use crate::console::{Console, Report};
use crate::failure::Failure;
use crate::scores;

pub(crate) fn run(
    args: &EvaluateArgs,
    config: &Config,
    console: &Console,
) -> Result<Report, Failure> {
    let agent =
        args.policy.as_deref().map(|policy| load(policy, args, config, console)).transpose()?;
    let agent = agent.as_ref().map(|(agent, sha256)| (&**agent, &**sha256));
    let mut config = config.clone();
    let methods = &mut config.evaluate.methods;
    // Nobody asked for each of them.
    let are_default = methods.starts_with(&EvaluateConfig::default().methods);
    let predictor = agent.and_then(|(agent, _)| agent.predictor());
    if predictor.is_some() && !methods.contains(&Method::Predictor) {
        methods.push(Method::Predictor);
    }
    let job = EvaluateJob {
        dataset: &args.dataset,
        agent,
        split: match args.split {
            SplitChoice::Train => Some(Split::Train),
            SplitChoice::Val => Some(Split::Val),
            SplitChoice::Test => Some(Split::Test),
            SplitChoice::All => None,
        },
        config: &config,
        out: &args.output.out,
        overwrite: args.output.overwrite,
    };
    let report = match evaluate(job, console) {
        Err(EvaluateError::Fit { learning, dataset, source, .. }) if are_default => {
            console.note(&format!(
                "note: {learning} are left out: they learn from the train split of {dataset}, but {source}"
            ));
            let mut config = config.clone();
            config.evaluate.methods.retain(|method| !method.learns());
            evaluate(EvaluateJob { config: &config, ..job }, console)?
        }
        other => other?,
    };
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
    Report::new(scores::text(&report), &summary)
}

/// A trained policy, and the SHA-256 of its weights.
type Loaded = (Box<dyn MakePolicy>, String);

#[cfg(feature = "torch")]
fn load(
    policy: &Path,
    args: &EvaluateArgs,
    config: &Config,
    console: &Console,
) -> Result<Loaded, Failure> {
    use holescout::dataset::Dataset;
    use holescout::rl::agent::{Agent, keep_freed_memory};
    use holescout::store::sha256_file;
    keep_freed_memory();
    let device = args.device.choice().device()?;
    let dataset = Dataset::open_with(&args.dataset, &config.remote)?;
    let (cells, cell_m) = (dataset.manifest().cells as usize, dataset.manifest().cell_m);
    let agent = Agent::load(policy, cells, &config.rl, device)?;
    if let Some((side, side_m)) = agent.trained_on().filter(|known| *known != (cells, cell_m)) {
        console.note(&format!(
            "note: {} was trained on maps of {side} × {side} cells of {side_m} m, and flies over \
             {cells} × {cells} cells of {cell_m} m",
            policy.display()
        ));
    }
    let weights = policy.join("weights.safetensors");
    Ok((Box::new(agent), sha256_file(&weights)?.sha256))
}

#[cfg(not(feature = "torch"))]
fn load(policy: &Path, _: &EvaluateArgs, _: &Config, _: &Console) -> Result<Loaded, Failure> {
    let policy = policy.display();
    Err(Failure::input(format!(
        "{policy}: this program was built without libtorch and knows no trained policies: \
         build it with `make train`, or with the feature torch"
    )))
}
