//! `holescout release`: a dataset in, a release out.

use std::path::{Component, Path, PathBuf};

use semver::Version;

use super::archive::Contents;
use super::date::Date;
use super::diff::{DiffError, compare, sums};
use super::scan::scan;
use super::version::{is_enough, least};
use super::{card, charts, page, rebuild};
use crate::dataset::{Dataset, ReadError, Record, croissant, record_schemas, reliability_of};
use crate::error::{Fault, FileError, HasFault};
use crate::manifest::{
    DatasetManifest, Manifest, Release, ShardEntry, Software, fingerprint, to_json,
};
use crate::progress::Progress;
use crate::store::{Build, Digest, MANIFEST, Output, OutputError, SUMS, sha256_bytes};

/// Zenodo takes no more files in a record.
const MOST_FILES: usize = 100;
const NOTICE: &str = "NOTICE";
const README: &str = "README.md";

/// Why there is no release.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReleaseError {
    /// The dataset, or the previous release, cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The previous release cannot be compared with.
    #[error(transparent)]
    Diff(#[from] DiffError),
    /// The output directory cannot be used.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A shard is not what its manifest says.
    #[error(
        "{}: differs from its manifest: expected {expected}, found {found}; build the dataset again",
        path.display()
    )]
    Damaged {
        /// The shard.
        path: PathBuf,
        /// From the manifest.
        expected: Digest,
        /// From the file.
        found: Digest,
    },
    /// A manifest that no run of this program wrote.
    #[error("{}: shard {file:?} is not {expected:?}; build the dataset again", path.display())]
    Shard {
        /// The manifest.
        path: PathBuf,
        /// What it names.
        file: String,
        /// What it should look like.
        expected: String,
    },
    /// A name that cannot be part of file names.
    #[error(
        "name {0:?}: expected letters, digits, '-', '_' and '.', beginning with a letter or digit"
    )]
    Name(String),
    /// The output would lie in the input.
    #[error("{} lies in the dataset that it would be made of: choose another --out", .0.display())]
    Inside(PathBuf),
    /// There is an archive with other bytes.
    #[error("{} exists with other bytes: remove it, or pass --overwrite to replace it", .0.display())]
    ArchiveExists(PathBuf),
    /// Too many files for a repository of data.
    #[error(
        "{shards} shards make {files} files, at most {MOST_FILES} are allowed (Zenodo): run \
         `holescout shard` with {}", mend(*.enough)
    )]
    TooManyFiles {
        /// Shards of the dataset.
        shards: usize,
        /// Files of the release.
        files: usize,
        /// A number of records in a shard that would do.
        enough: Option<u32>,
    },
    /// The version does not go as far as the changes ask for.
    #[error(
        "version {version} is too small a step from {previous}: {reason}, so that it must be at \
         least {least}; see `holescout diff`"
    )]
    Version {
        /// What was asked for.
        version: String,
        /// That of the previous release.
        previous: String,
        /// What asks for a larger step.
        reason: String,
        /// The least version that would do.
        least: String,
    },
    /// What should be the previous release is a dataset.
    #[error("{}: no release: its manifest has no version", .0.display())]
    NoRelease(PathBuf),
}

fn mend(enough: Option<u32>) -> String {
    match enough {
        Some(records) => format!("--records-per-shard {records}"),
        None => "fewer records".to_owned(),
    }
}

impl HasFault for ReleaseError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read(error) => error.fault(),
            Self::Diff(error) => error.fault(),
            Self::Output(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl From<FileError> for ReleaseError {
    fn from(error: FileError) -> Self {
        Self::Output(error.into())
    }
}

/// What to release, and as what.
#[derive(Debug, Clone)]
pub struct ReleaseJob<'a> {
    /// The dataset; a release stands for the dataset that it was made of.
    pub dataset: &'a Path,
    /// The directory to fill; by default `<name>-<version>` beside the dataset.
    pub out: Option<&'a Path>,
    /// Short name; by default that of the first extract.
    pub name: Option<&'a str>,
    /// Its version.
    pub version: &'a Version,
    /// Day of publication.
    pub date: Option<Date>,
    /// Where it is published.
    pub url: Option<&'a str>,
    /// Who made it.
    pub creators: &'a [String],
    /// What they say of it, in Markdown: a section of the card.
    pub notes: Option<&'a str>,
    /// The release before: the version must go as far from its as the changes ask for.
    pub previous: Option<&'a Path>,
    /// Whether to write an archive beside the directory, and the time that its files have.
    pub archive: Option<u64>,
    /// Replace a dataset that is there.
    pub overwrite: bool,
}

/// What was written.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Released {
    /// The directory.
    pub out: PathBuf,
    /// The archive.
    pub archive: Option<PathBuf>,
    /// Number of files in the directory.
    pub files: usize,
    /// Its manifest.
    pub manifest: DatasetManifest,
}

/// Releases a dataset.
///
/// # Errors
/// [`ReleaseError`]; the directory then has no manifest, unless the archive alone is in the way.
pub fn release(job: &ReleaseJob<'_>, progress: &dyn Progress) -> Result<Released, ReleaseError> {
    let dataset = Dataset::open(job.dataset)?;
    let manifest = published(&dataset, job)?;
    let shown = charts::chosen(&dataset);
    let files = count_files(&manifest, shown.len())?;
    let out = output_of(job, &manifest)?;
    let archive = job.archive.map(|mtime| (archive_of(&out), mtime));
    if let Some(previous) = job.previous {
        check_version(previous, &dataset, job.version, progress)?;
    }

    let build = Build::open_whole(&out, "dataset", &manifest.fingerprint, job.overwrite)?;
    let output = build.begin()?;
    copy_shards(&dataset, &output, progress)?;
    let scan = scan(&dataset, progress)?;
    for (id, _) in &shown {
        let picture = charts::of_record(&dataset, *id)?;
        output.write(&format!("{}/{id}.png", charts::FOLDER), &picture)?;
    }
    for (name, picture) in charts::histograms(&manifest, &scan) {
        output.write(&name, &picture)?;
    }
    output.write(page::FILE, page::page(&dataset, &manifest, progress)?.as_bytes())?;
    let bytes = to_json(&manifest);
    let table = output.write(croissant::TABLE, &scan.table)?;
    let description = croissant::croissant(&manifest, &sha256_bytes(&bytes), Some(&table));
    output.write(croissant::FILE, &description)?;
    for (name, schema) in schemas(&manifest) {
        output.write(&name, &schema)?;
    }
    for (name, text) in rebuild::files(&manifest) {
        output.write(name, &text)?;
    }
    output.write(NOTICE, card::notice(&manifest).as_bytes())?;
    output.write(README, card::readme(&manifest, &scan, &shown).as_bytes())?;
    output.complete(&bytes)?;

    if let Some((archive, mtime)) = &archive {
        let mut names: Vec<String> = sums(&out)?.into_keys().collect();
        names.push(SUMS.to_owned());
        let folder = &folder(&manifest);
        let contents = Contents { root: &out, folder, files: &names, mtime: *mtime };
        // What may be published already is replaced by other bytes only when that is asked for.
        if job.overwrite || !archive.exists() {
            contents.write(archive)?;
        } else if !contents.are_in(archive)? {
            return Err(ReleaseError::ArchiveExists(archive.clone()));
        }
    }
    Ok(Released { out, archive: archive.map(|(archive, _)| archive), files, manifest })
}

/// The manifest of the release.
fn published(dataset: &Dataset, job: &ReleaseJob<'_>) -> Result<DatasetManifest, ReleaseError> {
    let mut manifest = dataset.manifest().clone();
    check_shards(&manifest, job.dataset)?;
    let earlier = manifest.release.take();
    let name = job.name.map_or_else(|| croissant::default_name(&manifest), str::to_owned);
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    if !name.starts_with(|letter: char| letter.is_ascii_alphanumeric()) || !name.chars().all(plain)
    {
        return Err(ReleaseError::Name(name));
    }
    let release = Release {
        name,
        version: job.version.to_string(),
        date: job.date.map(|date| date.to_string()),
        url: job.url.map(str::to_owned),
        creators: job.creators.to_vec(),
        notes: job.notes.map(str::to_owned),
        software: Software::this(),
        dataset_manifest_sha256: earlier
            .map_or_else(|| dataset.digest().sha256.clone(), |it| it.dataset_manifest_sha256),
    };
    manifest.fingerprint = fingerprint(&(DatasetManifest::SCHEMA, &release));
    manifest.release = Some(release);
    Ok(manifest)
}

/// Names of shards become names of files: they must be those that this program gives.
fn check_shards(manifest: &DatasetManifest, root: &Path) -> Result<(), ReleaseError> {
    for ShardEntry { file, split, .. } in &manifest.shards {
        let expected = format!("{split}/shard-00000.msgpack.zst");
        let number = file
            .strip_prefix(&format!("{split}/shard-"))
            .and_then(|rest| rest.strip_suffix(".msgpack.zst"));
        if !number.is_some_and(|digits| digits.bytes().all(|byte| byte.is_ascii_digit())) {
            let path = root.join(MANIFEST);
            return Err(ReleaseError::Shard { path, file: file.clone(), expected });
        }
    }
    Ok(())
}

/// Names of a release's files besides shards, pictures and the list of checksums.
fn texts(manifest: &DatasetManifest) -> Vec<String> {
    let of_all = [MANIFEST, croissant::FILE, croissant::TABLE, NOTICE, README, page::FILE];
    let to_rebuild = rebuild::files(manifest).into_iter().map(|(name, _)| name);
    let texts = of_all.into_iter().chain(to_rebuild).map(str::to_owned);
    texts.chain(schemas(manifest).into_iter().map(|(name, _)| name)).collect()
}

/// Schemas of the records, by file name: that of records with errors where there are any.
fn schemas(manifest: &DatasetManifest) -> Vec<(String, Vec<u8>)> {
    let has_errors = reliability_of(manifest).is_some();
    let needed = |name: &str| name == Record::SCHEMA || has_errors;
    let schemas = record_schemas().into_iter().filter(|(name, _)| needed(name));
    schemas.map(|(name, schema)| (format!("{name}.json"), schema)).collect()
}

fn count_files(manifest: &DatasetManifest, pictures: usize) -> Result<usize, ReleaseError> {
    let shards = manifest.shards.len();
    // These, the list of checksums and two histograms.
    let others = texts(manifest).len() + 3;
    let files = shards + pictures + others;
    if files <= MOST_FILES {
        return Ok(files);
    }
    let room = (MOST_FILES - others - charts::RECORDS) as u64;
    let records: Vec<u64> = manifest.statistics.values().map(|split| split.records).collect();
    let enough = enough(&records, manifest.config.shard.records_per_shard, room);
    Err(ReleaseError::TooManyFiles { shards, files, enough })
}

/// The least number of records in a shard, from one on, with which the splits' records fill no more
/// shards than there is room for.
fn enough(records: &[u64], from: u32, room: u64) -> Option<u32> {
    let shards = |size: u32| records.iter().map(move |split| split.div_ceil(u64::from(size)));
    (from..=1 << 16).find(|&size| shards(size).sum::<u64>() <= room)
}

fn folder(manifest: &DatasetManifest) -> String {
    let release = manifest.release.as_ref();
    release.map_or_else(String::new, |release| format!("{}-{}", release.name, release.version))
}

/// Where the release goes: never into the dataset, which would be damaged by it.
fn output_of(job: &ReleaseJob<'_>, manifest: &DatasetManifest) -> Result<PathBuf, ReleaseError> {
    let root = job.dataset;
    let dataset = root.canonicalize().map_err(FileError::new("open", root))?;
    let out = match job.out {
        Some(out) => out.to_owned(),
        None if root.file_name().is_some() => root.with_file_name(folder(manifest)),
        None => dataset.with_file_name(folder(manifest)),
    };
    if absolute(&out)?.starts_with(&dataset) {
        return Err(ReleaseError::Inside(out));
    }
    Ok(out)
}

/// The path without links and dots, of which the end need not exist yet.
fn absolute(path: &Path) -> Result<PathBuf, FileError> {
    if let Ok(there) = path.canonicalize() {
        return Ok(there);
    }
    let whole = std::path::absolute(path).map_err(FileError::new("open", path))?;
    match (whole.parent(), whole.components().next_back()) {
        (Some(parent), Some(Component::Normal(name))) => Ok(absolute(parent)?.join(name)),
        _ => Ok(whole),
    }
}

fn archive_of(out: &Path) -> PathBuf {
    let mut archive = out.as_os_str().to_owned();
    archive.push(".tar");
    PathBuf::from(archive)
}

fn check_version(
    previous: &Path,
    dataset: &Dataset,
    version: &Version,
    progress: &dyn Progress,
) -> Result<(), ReleaseError> {
    let before = Dataset::open(previous)?;
    let release = before.manifest().release.as_ref();
    let Some(from) = release.and_then(|release| release.version.parse::<Version>().ok()) else {
        return Err(ReleaseError::NoRelease(previous.to_owned()));
    };
    // The texts are not written yet: they will differ, be it in the version only.
    let texts = texts(dataset.manifest());
    let texts = texts.into_iter().map(|name| (name, String::new()));
    let shards = dataset.manifest().shards.iter();
    let shards = shards.map(|shard| (shard.file.clone(), shard.digest.sha256.clone()));
    let changes = compare(&before, dataset, &texts.chain(shards).collect(), progress)?;
    let step = changes.step;
    if is_enough(&from, version, step) {
        return Ok(());
    }
    let reason = changes.reasons.first().map_or("it changed", |reason| &reason.text).to_owned();
    let (version, previous) = (version.to_string(), from.to_string());
    let least = least(&from, step).to_string();
    Err(ReleaseError::Version { version, previous, reason, least })
}

fn copy_shards(
    dataset: &Dataset,
    output: &Output,
    progress: &dyn Progress,
) -> Result<(), ReleaseError> {
    let shards = &dataset.manifest().shards;
    progress.begin("copying shards", Some(shards.len() as u64));
    for ShardEntry { file, digest: expected, .. } in shards {
        progress.advance(1);
        let path = dataset.root().join(file);
        let bytes = std::fs::read(&path).map_err(FileError::new("read", &path))?;
        let found = sha256_bytes(&bytes);
        if found != *expected {
            return Err(ReleaseError::Damaged { path, expected: expected.clone(), found });
        }
        output.write(file, &bytes)?;
    }
    progress.end();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_records_in_a_shard_as_are_needed() {
        assert_eq!(enough(&[100, 10, 10], 1, 12), Some(10));
        assert_eq!(enough(&[100, 11, 10], 1, 12), Some(11));
        assert_eq!(enough(&[100], 64, 12), Some(64));
        assert_eq!(enough(&[1 << 40], 1, 79), None);
    }
}
