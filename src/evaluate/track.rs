//! Flying one method over one map from many starts.

use crate::rl::policy::{Policy, View};
use crate::rl::{Cell, Flight, Random, Sight, World};

/// One flight from its start to its end.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Track {
    /// The cells whose centres it flew to, the start first.
    pub(super) path: Vec<Cell>,
    /// The waypoints that were predicted, one for each step.
    pub(super) predicted: Vec<[f64; 2]>,
    /// Levels measured on the path, in dBm.
    pub(super) rsrp_dbm: Vec<f32>,
    /// Predictions that were not permissible.
    pub(super) blocked: u64,
}

impl Track {
    /// The prediction after at most k steps.
    pub(super) fn cell_after(&self, k: u32) -> Cell {
        self.path[(k as usize).min(self.path.len() - 1)]
    }

    /// Steps made.
    pub(super) fn steps(&self) -> usize {
        self.path.len() - 1
    }

    /// Length of the path, in cells.
    pub(super) fn length(&self) -> f64 {
        let steps = self.path.windows(2).map(|ends| ends[1] - ends[0]);
        steps.map(|by| libm::hypot(by.row.into(), by.column.into())).sum()
    }
}

/// What flights take place in.
#[derive(Debug, Clone, Copy)]
pub(super) struct Airspace<'a> {
    /// The city as it is.
    pub(super) truth: &'a World,
    /// The city as the UAV has it stored, with the levels that it measures.
    pub(super) known: &'a World,
    /// Lines of sight.
    pub(super) sight: &'a Sight,
}

/// Flies from all starts, at most `most` steps each, step by step side by side. `key` keys the
/// random numbers of the method on this map.
pub(super) fn fly(
    place: Airspace<'_>,
    policy: &dyn Policy,
    starts: &[Cell],
    most: u32,
    key: &[u64],
) -> Vec<Track> {
    let Airspace { truth, known, sight } = place;
    let mut flights: Vec<Flight<'_>> =
        starts.iter().map(|&start| Flight::new(truth, known, sight, start)).collect();
    let mut randoms: Vec<Random> =
        (0..starts.len() as u64).map(|start| Random::keyed(&[key, &[start]].concat())).collect();
    let mut tracks: Vec<Track> = flights
        .iter()
        .map(|flight| Track {
            path: vec![flight.cell()],
            predicted: Vec::new(),
            rsrp_dbm: flight.measurements().iter().map(|measured| measured.rsrp_dbm).collect(),
            blocked: 0,
        })
        .collect();
    for _ in 0..most {
        let under_way: Vec<usize> =
            (0..flights.len()).filter(|&at| !flights[at].is_over()).collect();
        if under_way.is_empty() {
            break;
        }
        let views = flights.iter().zip(&mut randoms).filter(|(flight, _)| !flight.is_over());
        let mut views: Vec<View<'_, '_>> =
            views.map(|(flight, random)| View { flight, known, random }).collect();
        let waypoints = policy.predict(&mut views);
        for (&at, waypoint) in under_way.iter().zip(waypoints) {
            let (flight, track) = (&mut flights[at], &mut tracks[at]);
            let step = flight.step(waypoint, policy.keeps_fraction(), |cell| policy.allows(cell));
            track.path.push(flight.cell());
            track.predicted.push(waypoint);
            track.rsrp_dbm.extend(flight.measurements().last().map(|last| last.rsrp_dbm));
            track.blocked += u64::from(!step.permissible);
        }
    }
    tracks
}
