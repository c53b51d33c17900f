//! One map of the task: what blocks, what is a coverage hole, what a receiver measures.

use ndarray::Array2;

use super::cell::{Actions, Cell};
use crate::config::RlConfig;
use crate::dataset::{Grids, Record};
use crate::grid::TileId;
use crate::manifest::MASK_BUILDING;
use crate::random::Random;

const WORD: usize = u64::BITS as usize;

/// Rows of bits with a border of l cells around the map.
#[derive(Debug, Clone)]
struct BitRows {
    words: usize,
    bits: Vec<u64>,
}

impl BitRows {
    /// `value(row, column)` of all cells of the map and the border.
    fn new(cells: i32, border: i32, value: impl Fn(Cell) -> bool) -> Self {
        let side = (cells + 2 * border) as usize;
        // One word more, so that a window may always read two.
        let words = side / WORD + 2;
        let mut bits = vec![0; side * words];
        for row in 0..side {
            for column in 0..side {
                if value(Cell::new(row as i32 - border, column as i32 - border)) {
                    bits[row * words + column / WORD] |= 1 << (column % WORD);
                }
            }
        }
        Self { words, bits }
    }

    /// Up to 63 bits of a row of the border's grid.
    fn window(&self, row: usize, column: usize, width: usize) -> u64 {
        let at = row * self.words + column / WORD;
        let two = u128::from(self.bits[at]) | u128::from(self.bits[at + 1]) << WORD;
        (two >> (column % WORD)) as u64 & ((1 << width) - 1)
    }
}

/// A map: L × L cells, row 0 north, column 0 west.
#[derive(Debug, Clone)]
pub struct World {
    id: TileId,
    cells: usize,
    cell_m: f64,
    actions: Actions,
    threshold_dbm: f32,
    flight_height_m: f64,
    height_m: Array2<f32>,
    rsrp_dbm: Vec<f32>,
    occupied: Vec<bool>,
    outdoors: Vec<bool>,
    holes: Vec<bool>,
    /// Levels below the threshold, indoors included.
    weak: usize,
    base_station: [f64; 3],
    /// Occupied or outside of the map.
    closed: BitRows,
    /// Occupied, in the map, with a free neighbour along a row or column.
    walls: BitRows,
}

impl World {
    /// The task on a record.
    ///
    /// A cell is occupied (`S_bld`) if its height reaches `flight_height_m`; it is a coverage hole
    /// if it is outdoors, by the record's mask too, and its RSRP lies below `hole_threshold_dbm`.
    /// Levels below `floor_dbm` are raised to it, cells without a path hold it.
    ///
    /// # Panics
    /// If the grids are not square; those of a record are.
    #[must_use]
    pub fn new(record: &Record, grids: &Grids, config: &RlConfig) -> Self {
        let cells = grids.mask.nrows();
        assert!(grids.mask.is_square() && grids.height_m.dim() == grids.mask.dim());
        let occupied: Vec<bool> = grids
            .height_m
            .iter()
            .map(|&height| f64::from(height) >= config.flight_height_m)
            .collect();
        let floor = config.floor_dbm.0 as f32;
        let rsrp_dbm: Vec<f32> = grids.rsrp_dbm.iter().map(|&rsrp| rsrp.max(floor)).collect();
        let threshold_dbm = config.hole_threshold_dbm.0 as f32;
        let weak: Vec<bool> = rsrp_dbm.iter().map(|&rsrp| rsrp < threshold_dbm).collect();
        let free = occupied.iter().zip(&grids.mask);
        let outdoors: Vec<bool> =
            free.map(|(&occupied, &kind)| !occupied && kind != MASK_BUILDING).collect();
        let holes = outdoors.iter().zip(&weak).map(|(&outdoors, &weak)| outdoors && weak).collect();
        let middle = (cells as f64 - 1.0) / 2.0;
        let [east, north, up] = record.base_station.position_m;
        let base_station = [middle - north / record.cell_m, middle + east / record.cell_m, up];
        let actions = Actions::new(config.reach_cells);
        let (closed, walls) = bit_rows(cells, actions, &occupied);
        Self {
            id: record.id,
            cells,
            cell_m: record.cell_m,
            actions,
            threshold_dbm,
            flight_height_m: config.flight_height_m,
            height_m: grids.height_m.as_standard_layout().into_owned(),
            rsrp_dbm,
            occupied,
            outdoors,
            holes,
            weak: weak.into_iter().filter(|&weak| weak).count(),
            base_station,
            closed,
            walls,
        }
    }

    /// Memory that a map of `cells` × `cells` takes, at most, in bytes: heights and levels of 32
    /// bits, three bytes of flags, the positions of episodes' starts, rows of bits with a border.
    #[must_use]
    pub fn bytes(cells: usize) -> usize {
        (4 + 4 + 3 + 4 + 1) * cells * cells + size_of::<Self>()
    }

    /// The map as somebody has stored it who lacks a share of the buildings (connected occupied
    /// cells): each is missing with this probability. Levels and holes stay as they are.
    #[must_use]
    pub fn with_stale_buildings(&self, share: f64, random: &mut Random) -> Self {
        let mut stale = self.clone();
        for building in self.buildings() {
            if random.unit() < share {
                for at in building {
                    stale.occupied[at] = false;
                    stale.height_m[[at / self.cells, at % self.cells]] = 0.0;
                }
            }
        }
        (stale.closed, stale.walls) = bit_rows(self.cells, self.actions, &stale.occupied);
        stale
    }

    /// The map with an error in every level: normal, of a standard deviation in dB. Holes stay as
    /// they are; a cell that is measured twice has the same error.
    #[must_use]
    pub fn with_noise(&self, sigma_db: f64, random: &mut Random) -> Self {
        let mut noisy = self.clone();
        for rsrp in &mut noisy.rsrp_dbm {
            *rsrp += (sigma_db * random.normal()) as f32;
        }
        noisy
    }

    /// Occupied cells that hang together along rows and columns, as indices.
    fn buildings(&self) -> Vec<Vec<usize>> {
        let n = self.cells;
        let mut seen = vec![false; n * n];
        let mut buildings = Vec::new();
        for first in 0..n * n {
            if !self.occupied[first] || seen[first] {
                continue;
            }
            let mut building = Vec::new();
            let mut pending = vec![first];
            seen[first] = true;
            while let Some(at) = pending.pop() {
                building.push(at);
                for next in neighbours(self.cell(at)) {
                    if self.is_occupied(next) && !seen[self.index(next)] {
                        seen[self.index(next)] = true;
                        pending.push(self.index(next));
                    }
                }
            }
            buildings.push(building);
        }
        buildings
    }

    /// The tile.
    #[must_use]
    pub fn id(&self) -> TileId {
        self.id
    }

    /// Numbers that tell the tile from all others, for keys of random streams.
    #[must_use]
    pub fn key(&self) -> [u64; 3] {
        let TileId { utm, easting, northing } = self.id;
        [u64::from(utm.epsg()), easting as u64, northing as u64]
    }

    /// Cells along a side (L).
    #[must_use]
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// Side of a cell, in metres.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Cells that a step may lead in each direction (l).
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.actions.reach()
    }

    /// Heights in metres, `[L, L]`.
    #[must_use]
    pub fn height_m(&self) -> &Array2<f32> {
        &self.height_m
    }

    /// The same, row by row.
    ///
    /// # Panics
    /// Never: the grid is stored row by row.
    #[must_use]
    pub fn heights(&self) -> &[f32] {
        self.height_m.as_slice().expect("grids are stored row by row")
    }

    /// Whether each cell is occupied, row by row.
    pub(super) fn occupied(&self) -> &[bool] {
        &self.occupied
    }

    /// Row and column of the base station (which may lie outside of the map), and its height
    /// above the ground in metres.
    #[must_use]
    pub fn base_station(&self) -> [f64; 3] {
        self.base_station
    }

    /// Cells at least this high are occupied, in metres.
    #[must_use]
    pub fn flight_height_m(&self) -> f64 {
        self.flight_height_m
    }

    /// Below this an outdoor cell is a hole, in dBm.
    #[must_use]
    pub fn threshold_dbm(&self) -> f32 {
        self.threshold_dbm
    }

    /// Whether a cell lies in the map.
    #[must_use]
    pub fn contains(&self, cell: Cell) -> bool {
        let inside = 0..self.cells as i32;
        inside.contains(&cell.row) && inside.contains(&cell.column)
    }

    /// Position of a cell in row-major order.
    ///
    /// # Panics
    /// If the cell lies outside of the map.
    #[must_use]
    pub fn index(&self, cell: Cell) -> usize {
        assert!(self.contains(cell), "{cell:?} lies outside of map {}", self.id);
        cell.row as usize * self.cells + cell.column as usize
    }

    /// The cell at a position in row-major order.
    #[must_use]
    pub fn cell(&self, index: usize) -> Cell {
        Cell::new((index / self.cells) as i32, (index % self.cells) as i32)
    }

    /// Whether a cell lies in the map and is not occupied.
    #[must_use]
    pub fn is_free(&self, cell: Cell) -> bool {
        self.contains(cell) && !self.occupied[self.index(cell)]
    }

    /// Whether a cell lies in the map and is occupied (`S_bld`).
    #[must_use]
    pub fn is_occupied(&self, cell: Cell) -> bool {
        self.contains(cell) && self.occupied[self.index(cell)]
    }

    /// Whether a cell lies in the map, is not occupied, and is no building in the record either.
    #[must_use]
    pub fn is_outdoors(&self, cell: Cell) -> bool {
        self.contains(cell) && self.outdoors[self.index(cell)]
    }

    /// Whether a cell is a coverage hole: outdoors and below the threshold.
    #[must_use]
    pub fn is_hole(&self, cell: Cell) -> bool {
        self.contains(cell) && self.holes[self.index(cell)]
    }

    /// The level in a cell, in dBm per resource element.
    ///
    /// # Panics
    /// If the cell lies outside of the map.
    #[must_use]
    pub fn rsrp_dbm(&self, cell: Cell) -> f32 {
        self.rsrp_dbm[self.index(cell)]
    }

    /// Free cells, row by row.
    #[must_use]
    pub fn free_cells(&self) -> Vec<Cell> {
        let all = 0..self.cells * self.cells;
        all.filter(|&at| !self.occupied[at]).map(|at| self.cell(at)).collect()
    }

    /// Free cells that are no holes, row by row.
    pub fn covered(&self) -> impl Iterator<Item = Cell> {
        let all = 0..self.cells * self.cells;
        all.filter(|&at| !self.occupied[at] && !self.holes[at]).map(|at| self.cell(at))
    }

    /// Whether there is something to find and somewhere to begin: a hole and a covered free cell.
    #[must_use]
    pub fn can_teach(&self) -> bool {
        self.holes.contains(&true) && self.covered().next().is_some()
    }

    /// Coverage holes, row by row.
    #[must_use]
    pub fn holes(&self) -> Vec<Cell> {
        let all = 0..self.cells * self.cells;
        all.filter(|&at| self.holes[at]).map(|at| self.cell(at)).collect()
    }

    /// Number of coverage holes.
    #[must_use]
    pub fn hole_cells(&self) -> usize {
        self.holes.iter().filter(|&&hole| hole).count()
    }

    /// Number of cells below the threshold, indoors included: the paper's literal set of holes.
    #[must_use]
    pub fn weak_cells(&self) -> usize {
        self.weak
    }

    /// Cells of one row of the window around a cell that are occupied or outside of the map,
    /// the westernmost in the lowest bit.
    pub(super) fn closed_bits(&self, center: Cell, row: usize) -> u64 {
        self.closed.window(center.row as usize + row, center.column as usize, self.actions.side())
    }

    /// Cells of one row of the window around a cell that are walls.
    pub(super) fn wall_bits(&self, center: Cell, row: usize) -> u64 {
        self.walls.window(center.row as usize + row, center.column as usize, self.actions.side())
    }
}

fn bit_rows(cells: usize, actions: Actions, occupied: &[bool]) -> (BitRows, BitRows) {
    let n = cells as i32;
    let outside = |cell: Cell| !(0..n).contains(&cell.row) || !(0..n).contains(&cell.column);
    let closed = BitRows::new(n, actions.reach(), |cell| {
        outside(cell) || occupied[cell.row as usize * cells + cell.column as usize]
    });
    let walls = BitRows::new(n, actions.reach(), |cell| is_wall(cells, occupied, cell));
    (closed, walls)
}

fn is_wall(cells: usize, occupied: &[bool], cell: Cell) -> bool {
    let inside = |cell: &Cell| {
        (0..cells as i32).contains(&cell.row) && (0..cells as i32).contains(&cell.column)
    };
    let is_occupied = |cell: Cell| occupied[cell.row as usize * cells + cell.column as usize];
    inside(&cell)
        && is_occupied(cell)
        && neighbours(cell).into_iter().filter(inside).any(|next| !is_occupied(next))
}

/// The four cells beside a cell.
pub(crate) fn neighbours(cell: Cell) -> [Cell; 4] {
    [(-1, 0), (0, -1), (0, 1), (1, 0)].map(|(row, column)| cell + Cell::new(row, column))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::dataset::example;
    use crate::manifest::{MASK_REACHED, MASK_UNREACHED};

    /// A map drawn by letters: `.` covered (-80 dBm), `#` a building of 10 m, `o` a hole
    /// (-120 dBm), `x` a cell that no path reaches.
    pub(crate) fn world(map: &str, reach: u32) -> World {
        let config = RlConfig { reach_cells: reach, ..RlConfig::default() };
        let (record, grids) = drawn(map);
        World::new(&record, &grids, &config)
    }

    fn drawn(map: &str) -> (Record, Grids) {
        let rows: Vec<&str> = map.lines().map(str::trim).collect();
        let n = rows.len();
        let letter = |(row, column): (usize, usize)| rows[row].as_bytes()[column];
        let grids = Grids {
            height_m: Array2::from_shape_fn(
                (n, n),
                |at| if letter(at) == b'#' { 10.0 } else { 0.0 },
            ),
            rsrp_dbm: Array2::from_shape_fn((n, n), |at| match letter(at) {
                b'.' => -80.0,
                b'o' => -120.0,
                _ => -160.0,
            }),
            mask: Array2::from_shape_fn((n, n), |at| match letter(at) {
                b'#' => MASK_BUILDING,
                b'x' => MASK_UNREACHED,
                _ => MASK_REACHED,
            }),
            errors: None,
        };
        (example().0.with_grids(&grids), grids)
    }

    #[test]
    fn occupied_cells_are_no_holes_and_unreached_ones_are() {
        let world = world("..#\n.o#\nx..", 2);
        assert_eq!(world.holes(), [Cell::new(1, 1), Cell::new(2, 0)]);
        assert_eq!(world.free_cells().len(), 7);
        assert_eq!(world.weak_cells(), 4, "the paper's literal set has the indoor cells too");
        assert!(world.is_occupied(Cell::new(0, 2)) && !world.is_free(Cell::new(0, 2)));
        assert!(!world.is_free(Cell::new(-1, 0)) && !world.is_occupied(Cell::new(-1, 0)));
    }

    /// eqn "`S_bld`": a height equal to H is occupied; indoor cells that H lets through are flown
    /// over but never holes, for no level at H is known there.
    #[test]
    fn the_flight_height_decides_what_is_occupied() {
        let (record, grids) = drawn("#.\n..");
        let at = |flight_height_m| {
            let config = RlConfig { flight_height_m, ..RlConfig::default() };
            let world = World::new(&record, &grids, &config);
            (world.is_occupied(Cell::new(0, 0)), world.is_hole(Cell::new(0, 0)))
        };
        assert_eq!([at(2.0), at(10.0), at(10.5)], [(true, false), (true, false), (false, false)]);
    }

    #[test]
    fn levels_below_the_floor_are_raised_to_it() {
        let (record, mut grids) = drawn("..\n..");
        grids.rsrp_dbm[[0, 1]] = -330.0;
        let world = World::new(&record, &grids, &RlConfig::default());
        assert_eq!(world.rsrp_dbm(Cell::new(0, 1)), -160.0);
        assert!(world.is_hole(Cell::new(0, 1)));
    }

    #[test]
    fn the_base_station_lies_where_the_record_says() {
        // 1 m east, 2 m north, 12 m up from the middle of 3 cells of 4 m.
        assert_eq!(world("...\n...\n...", 2).base_station(), [0.5, 1.25, 12.0]);
    }

    #[test]
    fn stale_maps_lack_whole_buildings() {
        let world = world("#...\n##..\n...#\n..##", 3);
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let stale = world.with_stale_buildings(0.5, &mut Random::keyed(&[seed]));
            let left = stale.occupied.iter().filter(|&&occupied| occupied).count();
            assert_eq!(left % 3, 0, "buildings of three cells");
            assert_eq!(stale.holes(), world.holes());
            seen.insert(left);
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), [0, 3, 6]);
        let nothing = world.with_stale_buildings(1.0, &mut Random::keyed(&[0]));
        let sight = crate::rl::Sight::new(3);
        assert_eq!(sight.permissible(&nothing, Cell::new(0, 0)).count(), 16);
    }
}
