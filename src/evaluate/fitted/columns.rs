//! What trees are told of a move: where it leads, what was measured, and what stands around both ends.

use super::surroundings::{Surroundings, buildings, station};
use crate::rl::{Cell, Measurement, World};

/// Levels further below the threshold than this are not told apart, in dB.
const FLOOR_DB: f32 = 30.0;
/// Distance over which a measurement's weight falls by e, in cells.
const RANGE: f64 = 6.0;
/// What is told of the surroundings of the UAV itself: the distance to a wall, the built share in two
/// squares and the mean height in one.
const HERE: [usize; 4] = [0, 18, 19, 22];

/// Columns of a row to which the base station's are added, if they are told.
pub(super) const PLAIN: usize = 43;

/// A map, prepared.
#[derive(Debug)]
pub(super) struct Columns {
    buildings: Surroundings,
    /// If the base station's place is told.
    station: Option<Surroundings>,
    threshold_dbm: f32,
}

impl Columns {
    pub(super) fn new(world: &World, told: bool) -> Self {
        let station = told.then(|| station(world));
        Self { buildings: buildings(world), station, threshold_dbm: world.threshold_dbm() }
    }

    /// Adds a row for each move of a UAV that has measured something.
    pub(super) fn rows(
        &self,
        world: &World,
        measurements: &[Measurement],
        moves: &[Cell],
        out: &mut Vec<f32>,
    ) {
        let here = measurements.last().expect("the start is measured").cell;
        let floor = self.threshold_dbm - FLOOR_DB;
        let level = |of: &Measurement| f64::from(of.rsrp_dbm.max(floor) - self.threshold_dbm);
        let levels: Vec<f64> = measurements.iter().map(level).collect();
        let count = levels.len() as f64;
        let (lowest, highest) = extremes(&levels);
        let state = [
            levels[levels.len() - 1],
            levels[lowest],
            levels[highest],
            levels.iter().sum::<f64>() / count,
            count,
        ];
        let distance = |a: Cell, b: Cell| {
            let by = a - b;
            libm::hypot(by.row.into(), by.column.into())
        };
        for &to in moves {
            let (mut nearest, mut sum, mut weights) = (f64::INFINITY, 0.0, 0.0);
            for (measurement, level) in measurements.iter().zip(&levels) {
                let far = distance(to, measurement.cell);
                let weight = libm::exp(-far / RANGE);
                nearest = nearest.min(far);
                sum += weight * level;
                weights += weight;
            }
            let (by, from_lowest) = (to - here, to - measurements[lowest].cell);
            let place = [
                distance(to, here),
                by.row.into(),
                by.column.into(),
                from_lowest.row.into(),
                from_lowest.column.into(),
                nearest,
                sum / weights,
                distance(to, measurements[highest].cell),
            ];
            out.extend(state.iter().chain(&place).map(|&value| value as f32));
            let [to, here] = [to, here].map(|cell| world.index(cell));
            out.extend(self.buildings.of(to));
            out.extend(HERE.map(|column| self.buildings.of(here)[column]));
            if let Some(station) = &self.station {
                out.extend(station.of(to));
                out.extend(station.of(here));
            }
        }
    }
}

/// Places of the first of the lowest and of the highest values.
fn extremes(values: &[f64]) -> (usize, usize) {
    let (mut lowest, mut highest) = (0, 0);
    for (at, value) in values.iter().enumerate() {
        if *value < values[lowest] {
            lowest = at;
        }
        if *value > values[highest] {
            highest = at;
        }
    }
    (lowest, highest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rl::drawn_world as world;

    /// From (0, 0), measured -90 dBm, by (0, 3), measured -140 dBm, to (4, 3).
    #[test]
    fn a_row_by_hand() {
        let world = world(".....\n.#...\n.....\n.....\n.....", 4);
        let at = |row, column| Cell::new(row, column);
        let measured = [(at(0, 0), -90.0), (at(0, 3), -140.0)];
        let measured = measured.map(|(cell, rsrp_dbm)| Measurement { cell, rsrp_dbm });
        let rows = |told| {
            let mut rows = Vec::new();
            Columns::new(&world, told).rows(&world, &measured, &[at(4, 3)], &mut rows);
            rows
        };
        let row = rows(false);
        assert_eq!(row[..5], [-30.0, -30.0, 10.0, -10.0, 2.0], "the level is raised to the floor");
        assert_eq!(row[5..11], [4.0, 4.0, 0.0, 4.0, 0.0, 4.0]);
        let [near, far] = [-4.0_f32, -5.0].map(|far| (far / 6.0).exp());
        assert!((row[11] - (10.0 * far - 30.0 * near) / (near + far)).abs() < 1e-4);
        assert_eq!(row[12], 5.0);
        assert_eq!((row.len(), rows(true).len()), (13 + 26 + 4, 13 + 26 + 4 + 16));
        assert_eq!(row.len(), PLAIN);
        assert_eq!(rows(true)[..43], row);
    }
}
