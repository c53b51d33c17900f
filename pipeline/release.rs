//! `holescout release`.

use holescout::error::FileError;
use holescout::progress::Progress;
use holescout::release::{Date, ReleaseJob, release};
use serde_json::json;

use crate::cli::ReleaseArgs;
use crate::console::{Console, Report};
use crate::failure::Failure;

/// What reproducible builds take the time from: <https://reproducible-builds.org/specs/source-date-epoch/>
const EPOCH: &str = "SOURCE_DATE_EPOCH";

pub(crate) fn run(args: &ReleaseArgs, console: &Console) -> Result<Report, Failure> {
    let epoch = epoch()?;
    let date = match (args.date, epoch) {
        (Some(date), _) => Some(date),
        (None, Some(seconds)) => Some(Date::of_epoch(seconds).ok_or_else(|| {
            Failure::input(format!("{EPOCH}={seconds} lies after the year 9999"))
        })?),
        (None, None) => None,
    };
    let notes = args
        .notes
        .as_deref()
        .map(|path| std::fs::read_to_string(path).map_err(FileError::new("read", path)));
    let notes = notes.transpose()?;
    let mtime = epoch.or(date.map(Date::epoch)).unwrap_or(0);
    let job = ReleaseJob {
        dataset: &args.dataset,
        out: args.out.as_deref(),
        name: args.name.as_deref(),
        version: &args.version,
        date,
        url: args.url.as_deref(),
        creators: &args.creator,
        notes: notes.as_deref(),
        previous: args.previous.as_deref(),
        archive: args.tar.then_some(mtime),
        overwrite: args.overwrite,
    };
    if date.is_none() {
        console
            .note("note: no --date: croissant.json lacks datePublished, of which validators warn");
    }
    if args.url.is_none() {
        console.note("note: no --url: croissant.json lacks it, though Croissant asks for one");
    }
    let released = release(&job, console)?;
    let (out, archive) = (released.out.display(), released.archive.as_ref());
    let records = released.manifest.records.len();
    let summary = json!({
        "stage": "release",
        "version": args.version.to_string(),
        "out": released.out,
        "archive": archive,
        "files": released.files,
        "records": records,
        "shards": released.manifest.shards.len(),
    });
    let (version, files) = (&args.version, released.files);
    let archive = archive.map(|archive| format!("{}\n", archive.display())).unwrap_or_default();
    let text = format!("{out}: version {version}, {records} records, {files} files\n{archive}");
    Report::new(text, &summary)
}

fn epoch() -> Result<Option<u64>, Failure> {
    match std::env::var(EPOCH) {
        Err(std::env::VarError::NotPresent) => Ok(None),
        Err(error) => Err(Failure::input(format!("{EPOCH}: {error}"))),
        Ok(text) => text
            .parse()
            .map(Some)
            .map_err(|_| Failure::input(format!("{EPOCH}={text:?}: expected seconds since 1970"))),
    }
}
