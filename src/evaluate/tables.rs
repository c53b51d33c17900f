//! The figures as CSV tables, for other people's plots.

use super::map::MapResult;
use super::methods;
use super::report::{Interval, Report};
use crate::config::EvaluateConfig;
use crate::grid::TileId;

fn number(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| format!("{value:.6}"))
}

fn interval(value: Option<Interval>) -> [String; 3] {
    let part = |of: fn(Interval) -> f64| number(value.map(of));
    [part(|value| value.mean), part(|value| value.low), part(|value| value.high)]
}

fn csv<const N: usize>(header: [&str; N], rows: impl Iterator<Item = [String; N]>) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(header).expect("writing to memory cannot fail");
    for row in rows {
        csv.write_record(row).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

/// A row for each method, k and number of starts.
pub(super) fn scores(report: &Report) -> Vec<u8> {
    let header = [
        "method",
        "k",
        "starts",
        "precision",
        "precision_low",
        "precision_high",
        "recall",
        "recall_low",
        "recall_high",
        "recall_with_indoor",
        "recall_with_indoor_low",
        "recall_with_indoor_high",
    ];
    let rows = report.scores.iter().map(|score| {
        let [precision, precision_low, precision_high] = interval(score.precision);
        let [recall, recall_low, recall_high] = interval(score.recall);
        let [indoor, indoor_low, indoor_high] = interval(score.recall_with_indoor);
        [
            score.method.to_string(),
            score.k.to_string(),
            score.starts.to_string(),
            precision,
            precision_low,
            precision_high,
            recall,
            recall_low,
            recall_high,
            indoor,
            indoor_low,
            indoor_high,
        ]
    });
    csv(header, rows)
}

/// A row for each map, method and k, with all starts.
pub(super) fn maps(ids: &[TileId], maps: &[MapResult], config: &EvaluateConfig) -> Vec<u8> {
    let header =
        ["id", "outdoor_cells", "hole_cells", "hole_share", "method", "k", "precision", "recall"];
    let rows = ids.iter().zip(maps).flat_map(|(id, map)| {
        config.methods.iter().zip(&map.methods).flat_map(move |(&method, on_map)| {
            let steps = methods::steps(method, config);
            steps.iter().zip(&on_map.scores).map(move |(k, scores)| {
                let all = scores.last().expect("all starts");
                [
                    id.to_string(),
                    map.outdoor_cells.to_string(),
                    map.hole_cells.to_string(),
                    format!("{:.6}", map.hole_share()),
                    method.to_string(),
                    k.to_string(),
                    number(all.precision),
                    number(all.recall),
                ]
            })
        })
    });
    csv(header, rows)
}
