//! Files of base-station sites: CSV with a header, or what OpenCellID exports.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use csv::StringRecord;

use crate::error::{Fault, FileError, HasFault};

/// Radio technologies that begin the lines of OpenCellID's files without a header.
const RADIOS: [&str; 5] = ["GSM", "UMTS", "LTE", "NR", "CDMA"];
/// Columns of those files: radio, mcc, net, area, cell, unit, lon, lat, range, samples,
/// changeable, created, updated, averageSignal.
const OPENCELLID_COLUMNS: usize = 14;
const OPENCELLID_LON: usize = 6;
const OPENCELLID_LAT: usize = 7;
/// No mast is higher, in metres.
const MAX_HEIGHT_M: f64 = 1000.0;

/// Why a file of sites cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SitesError {
    /// The operating system failed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The first line is neither a header nor a line of OpenCellID.
    #[error(
        "{}: line 1 is {found:?}, expected a header with the columns lon and lat, or the 14 columns \
         of OpenCellID; add the header lon,lat,height,on_building,name", path.display()
    )]
    Header {
        /// The file.
        path: PathBuf,
        /// The line.
        found: String,
    },
    /// A line is broken.
    #[error("{}: line {line}: {column} is {found:?}, expected {expected}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What it holds.
        found: String,
        /// What it could hold.
        expected: &'static str,
    },
    /// It is no CSV.
    #[error("{}: {reason}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// The parser's reason, with the line.
        reason: String,
    },
}

impl HasFault for SitesError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

/// A line of a file of sites.
#[derive(Debug, Clone, PartialEq)]
pub struct Site {
    /// Longitude and latitude, in degrees.
    pub lon_lat: [f64; 2],
    /// Height in metres, over the roof if the site is on a building, else over the ground.
    pub height_m: Option<f64>,
    /// Whether it stands on a building.
    pub on_building: Option<bool>,
    /// Its name.
    pub name: Option<String>,
}

/// Where the columns are.
#[derive(Debug, Clone, Copy)]
struct SiteColumns {
    lon: usize,
    lat: usize,
    height: Option<usize>,
    on_building: Option<usize>,
    name: Option<usize>,
}

/// Calls `take` for every site of a file, in its order. Only one line is held at a time: exports
/// of whole countries have millions.
///
/// A header names the columns `lon` and `lat` (degrees) and, if there are such, `height` (metres),
/// `on_building` (true, false, yes, no, 1, 0) and `name`; other columns and empty lines are
/// passed over, and an empty field counts as not given. The country files of OpenCellID have no
/// header and are known by their first line.
///
/// # Errors
/// [`SitesError`] names the line, the column, what was found and what was expected.
pub fn read_sites(path: &Path, mut take: impl FnMut(Site)) -> Result<(), SitesError> {
    let file = File::open(path).map_err(FileError::new("open", path))?;
    let mut csv = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(file);
    let mut columns = None;
    let mut line = StringRecord::new();
    loop {
        match csv.read_record(&mut line) {
            Ok(true) => {}
            Ok(false) if columns.is_some() => return Ok(()),
            Ok(false) => return Err(header_error(path, &StringRecord::new())),
            Err(error) => return Err(csv_error(path, error)),
        }
        match columns {
            Some(columns) => take(site(&line, columns, path)?),
            None if is_opencellid(&line) => {
                let known = SiteColumns {
                    lon: OPENCELLID_LON,
                    lat: OPENCELLID_LAT,
                    height: None,
                    on_building: None,
                    name: None,
                };
                columns = Some(known);
                take(site(&line, known, path)?);
            }
            None => columns = Some(header(&line).ok_or_else(|| header_error(path, &line))?),
        }
    }
}

fn csv_error(path: &Path, error: csv::Error) -> SitesError {
    let reason = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(source) => FileError::new("read", path)(source).into(),
        _ => SitesError::Csv { path: path.to_owned(), reason },
    }
}

fn header_error(path: &Path, line: &StringRecord) -> SitesError {
    let found = line.iter().collect::<Vec<_>>().join(",");
    SitesError::Header { path: path.to_owned(), found }
}

fn is_opencellid(line: &StringRecord) -> bool {
    line.len() == OPENCELLID_COLUMNS && line.get(0).is_some_and(|radio| RADIOS.contains(&radio))
}

fn header(line: &StringRecord) -> Option<SiteColumns> {
    let position = |wanted: &str| {
        // Spreadsheets write a byte-order mark before the first name.
        let mut names = line.iter().map(|name| name.trim_start_matches('\u{feff}').trim());
        names.position(|name| name.eq_ignore_ascii_case(wanted))
    };
    Some(SiteColumns {
        lon: position("lon")?,
        lat: position("lat")?,
        height: position("height"),
        on_building: position("on_building"),
        name: position("name"),
    })
}

fn site(line: &StringRecord, columns: SiteColumns, path: &Path) -> Result<Site, SitesError> {
    let field = |at: usize| line.get(at).unwrap_or_default();
    let optional = |at: Option<usize>| at.map(field).filter(|text| !text.is_empty());
    let wrong = |column: &'static str, found: &str, expected: &'static str| SitesError::Line {
        path: path.to_owned(),
        line: line.position().map_or(0, |position| line_number(path, position)),
        column,
        found: found.to_owned(),
        expected,
    };
    let number = |column, text: &str, within: std::ops::RangeInclusive<f64>, expected| {
        let number: Option<f64> = text.parse().ok();
        number.filter(|number| within.contains(number)).ok_or_else(|| wrong(column, text, expected))
    };
    let lon = number("lon", field(columns.lon), -180.0..=180.0, "degrees from -180 to 180")?;
    let lat = number("lat", field(columns.lat), -90.0..=90.0, "degrees from -90 to 90")?;
    let height_m = optional(columns.height).map(|text| {
        let above = f64::MIN_POSITIVE..=MAX_HEIGHT_M;
        number("height", text, above, "metres, more than 0 and at most 1000")
    });
    let on_building =
        optional(columns.on_building).map(|text| match text.to_ascii_lowercase().as_str() {
            "true" | "yes" | "1" => Ok(true),
            "false" | "no" | "0" => Ok(false),
            _ => Err(wrong("on_building", text, "true, false, yes, no, 1 or 0")),
        });
    Ok(Site {
        lon_lat: [lon, lat],
        height_m: height_m.transpose()?,
        on_building: on_building.transpose()?,
        name: optional(columns.name).map(str::to_owned),
    })
}

/// The line that a record begins in. The parser counts from the empty lines before it on.
fn line_number(path: &Path, position: &csv::Position) -> u64 {
    let empty = || -> std::io::Result<u64> {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::Start(position.byte()))?;
        let mut lines = 0;
        for byte in BufReader::new(file).bytes() {
            match byte? {
                b'\n' => lines += 1,
                b'\r' => {}
                _ => break,
            }
        }
        Ok(lines)
    };
    position.line() + empty().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sites(text: &str) -> Result<Vec<Site>, SitesError> {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("sites.csv");
        std::fs::write(&path, text).expect("written");
        let mut sites = Vec::new();
        read_sites(&path, |site| sites.push(site))?;
        Ok(sites)
    }

    fn at(lon: f64, lat: f64) -> Site {
        Site { lon_lat: [lon, lat], height_m: None, on_building: None, name: None }
    }

    #[test]
    fn columns_are_found_by_name() {
        let text = "\u{feff}name, LAT ,owner,lon,on_building,height\n\
                    mast,60.1,me,24.9,no,30\n\n\"roof, old\",60.2,,-0.5,YES,\n,60.3,,1,,";
        let mast = Site {
            height_m: Some(30.0),
            on_building: Some(false),
            name: Some("mast".to_owned()),
            ..at(24.9, 60.1)
        };
        let roof =
            Site { on_building: Some(true), name: Some("roof, old".to_owned()), ..at(-0.5, 60.2) };
        assert_eq!(sites(text).expect("sound"), [mast, roof, at(1.0, 60.3)]);
    }

    #[test]
    fn exports_of_opencellid_are_read_with_and_without_header() {
        let line = "LTE,244,91,1337,42,0,24.94,60.17,1000,7,1,1459743588,1459743588,0\n";
        let header = "radio,mcc,net,area,cell,unit,lon,lat,range,samples,changeable,created,\
                      updated,averageSignal\n";
        let wanted = [at(24.94, 60.17), at(24.94, 60.17)];
        assert_eq!(sites(&[line, line].concat()).expect("sound"), wanted);
        assert_eq!(sites(&[header, line, line].concat()).expect("sound"), wanted);
    }

    #[test]
    fn bad_files_are_named_with_line_and_column() {
        for (text, says) in [
            ("", "line 1 is \"\""),
            ("longitude,latitude\n1,2\n", "columns lon and lat"),
            ("LTE,1,2\n", "columns lon and lat"),
            ("lon,lat\n1,2\n\r\n\nx,2\n", "line 5: lon is \"x\""),
            ("lon,lat\n1,91\n", "line 2: lat is \"91\""),
            ("lon,lat\n1\n", "line 2: lat is \"\""),
            ("lon,lat\nNaN,1\n", "line 2: lon is \"NaN\""),
            ("lon,lat,height\n1,2,0\n", "line 2: height is \"0\""),
            ("lon,lat,height\n1,2,inf\n", "line 2: height is \"inf\""),
            ("lon,lat,on_building\n1,2,maybe\n", "on_building is \"maybe\", expected true, false"),
        ] {
            let error = sites(text).expect_err(text);
            assert!(error.to_string().contains(says), "{text:?}: {error}");
            assert_eq!(error.fault(), Fault::Input);
        }
    }

    #[test]
    fn what_is_no_text_is_no_csv() {
        let dir = tempfile::tempdir().expect("a directory");
        let path = dir.path().join("sites.csv");
        std::fs::write(&path, b"lon,lat\n\xff,1\n").expect("written");
        let error = read_sites(&path, |_| {}).expect_err("no UTF-8");
        assert!(matches!(error, SitesError::Csv { .. }), "{error}");
        let missing = read_sites(&dir.path().join("none.csv"), |_| {}).expect_err("missing");
        assert!(missing.to_string().contains("none.csv"), "{missing}");
    }
}
