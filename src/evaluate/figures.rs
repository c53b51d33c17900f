//! The paper's two figures, precision and recall against the number of starts, and its second claim:
//! where holes lie.

use super::chart::{LineChart, Point, Series};
use super::report::{DistanceFigures, Interval, Report, Score};

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

/// Share of holes against distance to the nearest wall.
pub(super) fn of_distances(report: &Report) -> LineChart {
    let line = |label: &str, family, value: fn(&DistanceFigures) -> Option<Interval>| {
        let points = report.distances.iter().filter_map(|bin| {
            let Interval { mean, low, high } = value(bin)?;
            // What has no end is as wide as what comes before it.
            let to_m = bin.to_m.unwrap_or(1.25 * bin.from_m);
            Some(Point { x: f64::midpoint(bin.from_m, to_m), mean, low, high })
        });
        Series { label: label.to_owned(), points: points.collect(), family, variant: 0 }
    };
    let mut series = vec![line("holes", 0, |bin| bin.hole_share)];
    if report.labels.is_some() {
        series.push(line("chance of a hole", 1, |bin| bin.expected_hole_share));
    }
    LineChart {
        title: "Coverage holes by distance to the nearest wall".to_owned(),
        x_label: "distance to the nearest wall in m".to_owned(),
        y_label: "share of outdoor cells that are holes".to_owned(),
        y_max: None,
        log_x: false,
        steps: false,
        series,
    }
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
