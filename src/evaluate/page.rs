//! `report.html`: one file with charts, tables and the gallery, which needs no network.

use serde_json::json;

use super::gallery::GalleryMap;
use super::report::Report;

const TEMPLATE: &str = include_str!("page.html");

/// Fills the page.
pub(super) fn render(
    report: &Report,
    charts: &[(&str, String)],
    distance: &str,
    gallery: &[GalleryMap],
) -> String {
    let data = json!({ "report": report, "gallery": gallery }).to_string();
    // Within a script element only `</` and `<!--` have a meaning to HTML.
    let data = data.replace('<', "\\u003c");
    let charts: String = charts.iter().map(|(_, svg)| svg.as_str()).collect();
    let title = format!("Coverage-hole detection: {} split", report.split);
    // Data last: what they say must not be taken for a placeholder.
    let page = TEMPLATE.replace("{{title}}", &title).replace("{{charts}}", &charts);
    page.replace("{{distance}}", distance).replace("{{data}}", &data)
}
