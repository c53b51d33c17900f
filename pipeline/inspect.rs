//! `holescout inspect`: a dataset's figures, or one of its records.

use holescout::config::Config;
use holescout::dataset::{
    Dataset, Grids, PanelStyle, Record, hole_share, panels_png, record_json, records_csv,
    statistics_of, unsure_share,
};
use holescout::grid::TileId;
use holescout::manifest::SplitStatistics;
use holescout::store::write_atomic;
use holescout::units::Dbm;

use crate::cli::InspectArgs;
use crate::console::Report;
use crate::failure::Failure;
use crate::shard;

pub(crate) fn run(args: &InspectArgs, config: &Config) -> Result<Report, Failure> {
    let dataset = Dataset::open_with(&args.dataset, &config.remote)?;
    if let Some(path) = &args.csv {
        write_atomic(path, &records_csv(&dataset)?)?;
    }
    match &args.id {
        Some(id) => one_record(&dataset, id, args),
        None if args.png.is_some() => {
            Err(Failure::input("--png shows one record: name it by --id"))
        }
        None => {
            let manifest = dataset.manifest();
            Report::new(shard::text(manifest), manifest)
        }
    }
}

fn one_record(dataset: &Dataset, id: &str, args: &InspectArgs) -> Result<Report, Failure> {
    let id: TileId = id.parse().map_err(Failure::input)?;
    let (record, grids) = dataset.record_with_grids(id)?;
    if let Some(path) = &args.png {
        let threshold = args.hole_threshold.map_or(PanelStyle::default().hole_threshold, Dbm);
        let style = PanelStyle { scale: args.scale, hole_threshold: threshold };
        write_atomic(path, &panels_png(&record, &grids, style))?;
    }
    Report::new(text(&record, &grids), &record_json(&record, &grids))
}

fn text(record: &Record, grids: &Grids) -> String {
    let statistics = statistics_of(record, grids);
    let cells = statistics.cells;
    let [lon, lat] = record.center_lon_lat;
    let [east, north, up] = record.base_station.position_m;
    format!(
        "{} ({}), longitude {lon:.6}, latitude {lat:.6}\n\
         cells: {} reached, {} unreached, {} building; {:.1} % of outdoor cells are holes\n\
         highest building {:.1} m; base station {east:.1} m east, {north:.1} m north, {up:.1} m up, \
         {} dBm per resource element at {:.3} GHz\n\
         radio map {} ({}), {}\n",
        record.id,
        record.split,
        cells.reached,
        cells.unreached,
        cells.building,
        100.0 * hole_share(&statistics),
        grids.height_m.iter().copied().fold(0.0, f32::max),
        record.base_station.power_per_re_dbm.0,
        record.radio.frequency_hz / 1e9,
        record.provenance.radio_map.file,
        record.provenance.radio_map.value_kind.name(),
        record.radio.sionna_version,
    ) + reliability(&statistics).as_str()
}

/// How sure the holes are, where the map has several repeats.
fn reliability(statistics: &SplitStatistics) -> String {
    statistics.reliability.as_ref().map_or_else(String::new, |reliability| {
        format!(
            "{:.1} % of outdoor cells are holes with a chance of 5 to 95 %\n",
            100.0 * unsure_share(reliability)
        )
    })
}
