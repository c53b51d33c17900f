//! Which numbers of an array are the map.

use ndarray::Array2;

use super::rejection::{Rejection, RejectionCode};
use crate::store::Npy;

/// How the maps of transmitters lie in an array.
pub(super) struct Layout<'a> {
    shape: &'a [usize],
    /// Cells along a side of a map.
    pub(super) cells: usize,
    /// Number of maps.
    maps: usize,
    /// Positions of the map's, the row's and the column's axis.
    axes: [usize; 3],
}

impl<'a> Layout<'a> {
    /// Squares, alone or stacked along the first or the last axis.
    pub(super) fn of(shape: &'a [usize]) -> Result<Self, Rejection> {
        let layout = match *shape {
            [rows, columns] if rows == columns => (rows, 1, [usize::MAX, 0, 1]),
            [n, rows, columns] if rows == columns => (rows, n, [0, 1, 2]),
            [rows, columns, n] if rows == columns => (rows, n, [2, 0, 1]),
            _ => return Err(wrong_shape(shape)),
        };
        let (cells, maps, axes) = layout;
        let layout = Self { shape, cells, maps, axes };
        if layout.cells == 0 || layout.maps == 0 {
            return Err(wrong_shape(shape));
        }
        Ok(layout)
    }

    /// One map in C layout.
    pub(super) fn matrix(&self, npy: &Npy<'_>, map: usize) -> Array2<f64> {
        let axes = npy.shape.len();
        let mut strides = [0; 3];
        let mut step = 1;
        for axis in 0..axes {
            // In Fortran order the first index runs fastest.
            let axis = if npy.fortran_order { axis } else { axes - 1 - axis };
            strides[axis] = step;
            step *= npy.shape[axis];
        }
        let stride = |axis: usize| strides.get(axis).copied().unwrap_or(0);
        let [of_map, of_row, of_column] = self.axes.map(stride);
        Array2::from_shape_fn((self.cells, self.cells), |(row, column)| {
            let index = map * of_map + row * of_row + column * of_column;
            npy.value_f64(index).expect("the type was checked, the length against the shape")
        })
    }

    /// Which transmitter's map is meant. A single map needs no choice; `positions` are told by
    /// the metadata.
    pub(super) fn choose(&self, positions: usize, tx: Option<usize>) -> Result<usize, Rejection> {
        let reject = |code, expected: String, mend: &str| {
            let found = format!("shape {:?}, {positions} positions in tx_position_m", self.shape);
            Err(Rejection::new(code, expected, found, mend))
        };
        let several = RejectionCode::SeveralTransmitters;
        match (self.maps, positions, tx) {
            (1, 1, _) => Ok(0),
            (1, ..) => reject(
                several,
                "the map of one transmitter".to_owned(),
                "what several transmitters give together is no RSRP: trace each by itself",
            ),
            (_, _, None) => reject(
                several,
                "the map of one transmitter, or a choice".to_owned(),
                "choose one with --tx INDEX (from 0), or save one file a transmitter",
            ),
            (maps, _, Some(tx)) if tx >= maps => reject(
                RejectionCode::NoSuchTransmitter,
                format!("transmitter {tx}, counted from 0"),
                "choose another --tx",
            ),
            (maps, positions, Some(tx)) if positions == maps => Ok(tx),
            (maps, ..) => reject(
                RejectionCode::InvalidMetadata,
                format!("{maps} positions in tx_position_m, one a map"),
                "write tx_position_m as [[x, y, z], ...] in the order of the maps",
            ),
        }
    }
}

fn wrong_shape(shape: &[usize]) -> Rejection {
    let (expected, found) = ("[n, n], or [transmitters, n, n]", format!("{shape:?}"));
    let mend = match shape {
        [_] => "values on the faces of a mesh are no grid: trace a plane (center, size, cell_size)",
        _ => "trace a square map with square cells",
    };
    Rejection::new(RejectionCode::WrongShape, expected, found, mend)
}

/// Positions from an array `[3, n]` (as in Mitsuba) or `[n, 3]`.
pub(super) fn positions(npy: &Npy<'_>) -> Option<Vec<[f64; 3]>> {
    let values = npy.values_f64();
    let [rows, columns] = npy.shape[..] else { return None };
    // Text has no values.
    if values.len() != rows.checked_mul(columns)? {
        return None;
    }
    let at = |row: usize, column: usize| {
        values[if npy.fortran_order { column * rows + row } else { row * columns + column }]
    };
    match (rows, columns) {
        (3, _) => Some((0..columns).map(|n| [at(0, n), at(1, n), at(2, n)]).collect()),
        (_, 3) => Some((0..rows).map(|n| [at(n, 0), at(n, 1), at(n, 2)]).collect()),
        _ => None,
    }
}
