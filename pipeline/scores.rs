//! The scores of an evaluation on a terminal.

use std::fmt::Write;

use holescout::evaluate::{Interval, Report as Evaluation};

/// Precision and recall with all starts, a line a method.
pub(crate) fn text(report: &Evaluation) -> String {
    let (measures, width) = match &report.labels {
        Some(_) => ("precision / recall / expected precision", 21),
        None => ("precision / recall", 14),
    };
    let mut text = format!(
        "{} maps, {} starts on each; {measures} in % after at most k steps\n{:<28}",
        report.maps.evaluated, report.evaluate.starts, "",
    );
    for k in &report.evaluate.steps {
        write!(text, "{:>width$}", format!("k = {k}")).expect("writing to a string cannot fail");
    }
    text.push('\n');
    let percent: fn(Option<Interval>) -> String =
        |value| value.map_or_else(|| "-".to_owned(), |value| format!("{:.1}", 100.0 * value.mean));
    for method in &report.methods {
        write!(text, "{:<28}", method.title).expect("writing to a string cannot fail");
        for &k in &report.evaluate.steps {
            let scores = report.score(method.name, k).map_or_else(String::new, |score| {
                let expected = score.expected_precision.map(|_| percent(score.expected_precision));
                let shown = [percent(score.precision), percent(score.recall)].into_iter();
                shown.chain(expected).collect::<Vec<_>>().join(" / ")
            });
            write!(text, "{scores:>width$}").expect("writing to a string cannot fail");
        }
        text.push('\n');
    }
    text.push_str(&labels(report, percent, width));
    text
}

/// The label ceiling, and how sure holes are; that it is unknown where no map tells.
fn labels(report: &Evaluation, percent: fn(Option<Interval>) -> String, width: usize) -> String {
    let Some(labels) = &report.labels else {
        return "how sure the holes are is unknown: no map tells errors\n".to_owned();
    };
    let mut text = String::new();
    if !labels.ceiling.is_empty() {
        let scores = labels.ceiling.iter().map(|at| {
            let scores =
                format!("{} / - / {}", percent(at.precision), percent(at.expected_precision));
            format!("{scores:>width$}")
        });
        text = format!("{:<28}{}\n", "Label ceiling", scores.collect::<String>());
    }
    let share = |cells: u64| 100.0 * cells as f64 / labels.outdoor_cells.max(1) as f64;
    let (sure, unsure) = (share(labels.sure_holes), share(labels.unsure));
    let told = format!(
        "{} of {} maps tell errors, which expected precision is of: {sure:.1} % of their outdoor cells are surely holes, {unsure:.1} % are unsure\n",
        labels.maps, report.maps.evaluated
    );
    text + told.as_str()
}
