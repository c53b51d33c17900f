//! The configuration: one type a section of the TOML file, with the defaults.
//!
//! Plain data and its validation. It sits low in the import order because every
//! manifest records the sections that made it. Unknown keys are errors.

mod dataset;
mod remote;
mod rl;
mod rsrp;
mod scenes;
mod tiles;
mod train;

pub use dataset::{
    HeightDownsampling, RsrpDownsampling, ShardConfig, Split, SplitArea, SplitConfig, UnknownSplit,
};
pub use remote::RemoteConfig;
pub use rl::{EvaluateConfig, Method, MethodError, RlConfig};
pub use rsrp::{Preset, RsrpConfig};
pub use scenes::{Material, Placement, SceneConfig};
pub use tiles::{BuildingsConfig, FilterConfig, GridConfig};
pub use train::{Channel, Encoding, Loss, OnDamage, Precision, TrainConfig};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A value of the configuration that cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("configuration: {key} is {found}, expected {expected}")]
pub struct ConfigError {
    /// The key, as `section.key`.
    pub key: &'static str,
    /// What was given.
    pub found: String,
    /// What is possible.
    pub expected: String,
}

impl crate::error::HasFault for ConfigError {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}

#[cfg(feature = "build")]
/// Why a file is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ParseError {
    /// It has settings that have another name now.
    #[error("{}", told.join("; "))]
    Renamed {
        /// What each is called.
        told: Vec<String>,
    },
    /// It is not TOML, or has unknown settings or values of another kind.
    #[error(transparent)]
    Toml(#[from] toml::de::Error),
}

#[cfg(feature = "build")]
impl crate::error::HasFault for ParseError {
    fn fault(&self) -> crate::error::Fault {
        crate::error::Fault::Input
    }
}

fn demand(
    holds: bool,
    key: &'static str,
    found: impl std::fmt::Display,
    expected: impl std::fmt::Display,
) -> Result<(), ConfigError> {
    if holds {
        Ok(())
    } else {
        Err(ConfigError { key, found: found.to_string(), expected: expected.to_string() })
    }
}

/// All sections.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Tiles and their lattice.
    pub grid: GridConfig,
    /// Which buildings count, and how high they are.
    pub buildings: BuildingsConfig,
    /// Which tiles are urban enough.
    pub filter: FilterConfig,
    /// Scenes for a ray tracer.
    pub scenes: SceneConfig,
    /// Import of radio maps.
    pub rsrp: RsrpConfig,
    /// Records and shards.
    pub shard: ShardConfig,
    /// Train, validation and test.
    pub split: SplitConfig,
    /// The task: coverage holes, moves, encodings.
    pub rl: RlConfig,
    /// How the Q-network is trained.
    pub train: TrainConfig,
    /// How policies are judged.
    pub evaluate: EvaluateConfig,
    /// Datasets on servers.
    pub remote: RemoteConfig,
}

impl Config {
    #[cfg(feature = "build")]
    /// Reads a file's text; what it does not tell is as by default. Values are not checked yet.
    ///
    /// # Errors
    /// [`ParseError`].
    pub fn parse(text: &str) -> Result<Self, ParseError> {
        let table: toml::Table = text.parse()?;
        let has = |key: &str| table.get("train").is_some_and(|train| train.get(key).is_some());
        let old = train::RENAMED.iter().filter(|(old, _)| has(old));
        let section = table.contains_key("scene");
        let told: Vec<String> = section
            .then(|| "[scene] is called [scenes] now".to_owned())
            .into_iter()
            .chain(old.map(|(old, new)| format!("train.{old} is called train.{new} now")))
            .collect();
        if told.is_empty() { Ok(toml::from_str(text)?) } else { Err(ParseError::Renamed { told }) }
    }

    /// Checks every value and every relation between values.
    ///
    /// # Errors
    /// The first [`ConfigError`] found, in the order of the sections.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.grid.validate()?;
        self.buildings.validate()?;
        self.filter.validate()?;
        self.scenes.validate()?;
        self.rsrp.validate()?;
        self.shard.validate(&self.grid)?;
        self.split.validate()?;
        self.rl.validate()?;
        self.train.validate()?;
        self.evaluate.validate()?;
        self.remote.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Dbm;

    #[test]
    fn splits_are_read_from_their_names() {
        for split in Split::ALL {
            assert_eq!(split.name().parse(), Ok(split));
        }
        let error = "Train".parse::<Split>().expect_err("no split");
        assert_eq!(error.to_string(), "\"Train\" is no split: expected train, val or test");
    }

    #[test]
    fn the_defaults_are_valid_and_give_the_papers_grid() {
        let config = Config::default();
        config.validate().expect("defaults are valid");
        assert_eq!(config.grid.side_cells(), 1080);
        assert_eq!(config.grid.crop_offset_cells(), 298);
        assert_eq!(config.shard.record_cells(&config.grid), 121);
    }

    #[test]
    fn unknown_keys_are_refused() {
        let error = toml::from_str::<Config>("[grid]\nspacing = 5\n").expect_err("no such key");
        assert!(error.to_string().contains("spacing"), "{error}");
    }

    #[test]
    fn settings_of_another_name_are_told_by_their_new_one() {
        let error = Config::parse("[train]\nreplay = 5\nseed = 1\nwarmup = 2").expect_err("old");
        assert_eq!(
            error.to_string(),
            "train.replay is called train.buffer_size now; train.warmup is called train.learning_starts now"
        );
        let error = Config::parse("[scene]\nseed = 1").expect_err("old");
        assert_eq!(error.to_string(), "[scene] is called [scenes] now");
        let known = toml::Table::try_from(TrainConfig::default()).expect("a table");
        for (old, new) in train::RENAMED {
            let new = new.split_whitespace().next().expect("a name");
            assert!(known.contains_key(new) && !known.contains_key(old), "{old} {new}");
        }
    }

    #[test]
    fn impossible_values_are_named() {
        let mut broken: Vec<Config> = vec![Config::default(); 9];
        broken[0].grid.crop_m = 2000;
        broken[1].grid.cell_m = 0.0;
        broken[2].shard.downsample = 5;
        broken[3].split.test = 0.95;
        broken[4].filter.min_built = -0.1;
        broken[5].rsrp.floor_dbm = Dbm(0.0);
        broken[6].buildings.default_heights_m.insert("house".into(), f64::NAN);
        broken[7].grid.crop_m = 483;
        broken[8].split.areas.push(SplitArea {
            name: "empty".into(),
            split: Split::Test,
            bbox: [1.0, 0.0, 0.0, 1.0],
        });
        let keys = broken.iter().map(|config| config.validate().expect_err("invalid").key);
        assert_eq!(
            keys.collect::<Vec<_>>(),
            [
                "grid.crop_m",
                "grid.cell_m",
                "shard.downsample",
                "split.test",
                "filter.min_built",
                "rsrp.floor_dbm",
                "buildings.default_heights_m",
                "grid.crop_m",
                "split.areas"
            ]
        );
    }
}
