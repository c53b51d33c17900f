//! The paper's two figures: precision and recall against the number of starts.

use super::chart::{LineChart, Point, Series};
use super::report::{Interval, Report, Score};

/// The charts of a report, by file name.
pub(super) fn of_report(report: &Report) -> [(&'static str, LineChart); 2] {
    let chart = |title: &str, y_label: &str, value: fn(&Score) -> Option<Interval>| LineChart {
        title: title.to_owned(),
        x_label: "starts on each map (N_sam)".to_owned(),
        y_label: y_label.to_owned(),
        y_max: None,
        log_x: false,
        steps: false,
        series: series(report, value),
    };
    [
        ("precision", chart("Precision of predicted coverage holes", "precision", |s| s.precision)),
        ("recall", chart("Recall of coverage holes", "recall", |s| s.recall)),
    ]
}

/// A line for each method and number of steps; the page knows methods by `family` and steps by
/// `variant`. Methods that move have none for k = 0: they start where RSP or BNP do.
fn series(report: &Report, value: fn(&Score) -> Option<Interval>) -> Vec<Series> {
    let mut series = Vec::new();
    for (family, method) in report.methods.iter().enumerate() {
        let steps = if method.multi_step { &report.evaluate.steps[..] } else { &[0] };
        for (variant, &k) in steps.iter().enumerate() {
            if method.multi_step && k == 0 {
                continue;
            }
            let scores = report.scores.iter().filter(|s| (s.method, s.k) == (method.name, k));
            let points = scores.filter_map(|score| {
                let Interval { mean, low, high } = value(score)?;
                Some(Point { x: score.starts.into(), mean, low, high })
            });
            let title = &method.title;
            let label = if k > 0 { format!("{title}, k = {k}") } else { title.clone() };
            series.push(Series { label, points: points.collect(), family, variant });
        }
    }
    series
}
