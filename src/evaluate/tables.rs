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

fn csv<H: AsRef<[u8]>>(
    header: impl IntoIterator<Item = H>,
    rows: impl Iterator<Item = Vec<String>>,
) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    csv.write_record(header).expect("writing to memory cannot fail");
    for row in rows {
        csv.write_record(row).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

/// The tables that follow from a report alone, by their names.
pub(crate) fn derived_tables(report: &Report) -> [(&'static str, Vec<u8>); 2] {
    [("scores.csv", scores(report)), ("distance.csv", distances(report))]
}

/// A row for each method, k and number of starts; what errors tell only where there are some.
fn scores(report: &Report) -> Vec<u8> {
    let mut header = vec![
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
    let has_errors = report.labels.is_some();
    if has_errors {
        header.extend([
            "expected_precision",
            "expected_precision_low",
            "expected_precision_high",
            "sure_holes",
            "sure_holes_low",
            "sure_holes_high",
            "sure",
            "sure_low",
            "sure_high",
        ]);
    }
    let rows = report.scores.iter().map(|score| {
        let [precision, precision_low, precision_high] = interval(score.precision);
        let [recall, recall_low, recall_high] = interval(score.recall);
        let [indoor, indoor_low, indoor_high] = interval(score.recall_with_indoor);
        let mut row = vec![
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
        ];
        if has_errors {
            let of_errors = [score.expected_precision, score.sure_holes, score.sure];
            row.extend(of_errors.into_iter().flat_map(interval));
        }
        row
    });
    csv(header, rows)
}

/// A row for each distance to walls.
fn distances(report: &Report) -> Vec<u8> {
    let mut header = vec!["from_m", "to_m", "cells", "holes"];
    header.extend(["hole_share", "hole_share_low", "hole_share_high"]);
    let has_errors = report.labels.is_some();
    if has_errors {
        header.extend(["expected", "expected_low", "expected_high"]);
    }
    let rows = report.distances.iter().map(|bin| {
        let mut row = vec![
            bin.from_m.to_string(),
            bin.to_m.map_or_else(String::new, |to_m| to_m.to_string()),
            bin.cells.to_string(),
            bin.holes.to_string(),
        ];
        row.extend(interval(bin.hole_share));
        if has_errors {
            row.extend(interval(bin.expected_hole_share));
        }
        row
    });
    csv(header, rows)
}

/// A row for each map, method and k, with all starts.
pub(super) fn maps(ids: &[TileId], maps: &[MapResult], config: &EvaluateConfig) -> Vec<u8> {
    let mut header = vec![
        "id",
        "outdoor_cells",
        "hole_cells",
        "hole_share",
        "method",
        "k",
        "precision",
        "recall",
    ];
    let has_errors = maps.iter().any(|map| map.labels.is_some());
    if has_errors {
        header.extend(["expected_precision", "sure_holes", "sure"]);
    }
    let rows = ids.iter().zip(maps).flat_map(|(id, map)| {
        config.methods.iter().zip(&map.methods).flat_map(move |(&method, on_map)| {
            let steps = methods::steps(method, config);
            steps.iter().zip(&on_map.scores).map(move |(k, scores)| {
                let all = scores.last().expect("all starts");
                let mut row = vec![
                    id.to_string(),
                    map.outdoor_cells.to_string(),
                    map.hole_cells.to_string(),
                    format!("{:.6}", map.hole_share()),
                    method.to_string(),
                    k.to_string(),
                    number(all.precision),
                    number(all.recall),
                ];
                if has_errors {
                    row.extend([all.expected, all.sure_holes, all.sure].map(number));
                }
                row
            })
        })
    });
    csv(header, rows)
}
