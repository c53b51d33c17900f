//! A record as a picture: heights, RSRP and coverage holes side by side.

use colorous::{INFERNO, VIRIDIS};
use font8x8::UnicodeFonts;
use ndarray::Array2;

use super::grids::Grids;
use super::record::Record;
use crate::manifest::{MASK_BUILDING, MASK_REACHED};
use crate::units::Dbm;

type Rgb = [u8; 3];

const WHITE: Rgb = [255, 255, 255];
const INK: Rgb = [30, 30, 30];
const BUILDING: Rgb = [120, 120, 120];
const COVERED: Rgb = [222, 235, 247];
const HOLE: Rgb = [203, 24, 29];
const UNREACHED: Rgb = [20, 12, 40];
const STATION: Rgb = [255, 200, 0];

const MARGIN: usize = 14;
const GLYPH: usize = 8;
const TITLE: usize = GLYPH + 8;
/// RSRP at the ends of the colour bar, in dBm.
const RSRP_RANGE: [f64; 2] = [-140.0, -50.0];

/// How a record is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PanelStyle {
    /// Pixels along a side of a cell, 1 to 16.
    pub scale: usize,
    /// Outdoor cells below this are coverage holes.
    pub hole_threshold: Dbm,
}

impl Default for PanelStyle {
    fn default() -> Self {
        Self { scale: 3, hole_threshold: Dbm(-100.0) }
    }
}

struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: [WHITE].concat().repeat(width * height) }
    }

    fn set(&mut self, x: usize, y: usize, color: Rgb) {
        if x < self.width && y < self.height {
            let at = 3 * (y * self.width + x);
            self.pixels[at..at + 3].copy_from_slice(&color);
        }
    }

    fn rectangle(&mut self, [x, y]: [usize; 2], [width, height]: [usize; 2], color: Rgb) {
        for row in y..y + height {
            for column in x..x + width {
                self.set(column, row, color);
            }
        }
    }

    fn text(&mut self, text: &str, [x, y]: [usize; 2]) {
        for (index, letter) in text.chars().enumerate() {
            let glyph = font8x8::BASIC_FONTS.get(letter).unwrap_or([0; GLYPH]);
            for (row, bits) in glyph.iter().enumerate() {
                for column in (0..GLYPH).filter(|column| bits >> column & 1 == 1) {
                    self.set(x + index * GLYPH + column, y + row, INK);
                }
            }
        }
    }

    /// Draws a matrix of colours, with a title above and a caption below.
    fn panel(
        &mut self,
        cells: &Array2<Rgb>,
        corner: [usize; 2],
        scale: usize,
        [title, caption]: [&str; 2],
    ) {
        let [x, y] = corner;
        self.text(title, [x, y]);
        for ((row, column), &color) in cells.indexed_iter() {
            let at = [x + column * scale, y + TITLE + row * scale];
            self.rectangle(at, [scale, scale], color);
        }
        self.text(caption, [x, y + TITLE + cells.nrows() * scale + 6]);
    }

    fn bar(&mut self, [x, y]: [usize; 2], width: usize, color: impl Fn(f64) -> Rgb) {
        for column in 0..width {
            let shade = color(column as f64 / (width - 1) as f64);
            self.rectangle([x + column, y], [1, GLYPH], shade);
        }
    }

    fn into_png(self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&self.pixels))
            .expect("writing to memory cannot fail");
        bytes
    }
}

/// A PNG of three panels: building heights, RSRP, coverage holes; north is up, the base
/// station is the yellow cross.
#[must_use]
pub fn panels_png(record: &Record, grids: &Grids, style: PanelStyle) -> Vec<u8> {
    let scale = style.scale.clamp(1, 16);
    let side = grids.mask.nrows() * scale;
    let step = side + MARGIN;
    let top = MARGIN + TITLE;
    let bar_y = top + TITLE + side + 6 + TITLE;
    let mut canvas = Canvas::new(3 * step + MARGIN, bar_y + GLYPH + MARGIN);

    let highest = grids.height_m.iter().copied().fold(1.0_f32, f32::max);
    let heights = grids.height_m.mapv(|height| {
        if height > 0.0 { height_color(f64::from(height / highest)) } else { WHITE }
    });
    let rsrp = shade(grids, |kind, level| match kind {
        MASK_BUILDING => BUILDING,
        MASK_REACHED => rsrp_color((level - RSRP_RANGE[0]) / (RSRP_RANGE[1] - RSRP_RANGE[0])),
        _ => UNREACHED,
    });
    let is_hole = |kind: u8, level: f64| {
        kind != MASK_BUILDING && (kind != MASK_REACHED || level < style.hole_threshold.0)
    };
    let holes = shade(grids, |kind, level| match kind {
        MASK_BUILDING => BUILDING,
        _ if is_hole(kind, level) => HOLE,
        _ => COVERED,
    });
    let count = |wanted: &dyn Fn(u8, f64) -> bool| {
        let cells = grids.mask.iter().zip(&grids.rsrp_dbm);
        cells.filter(|(kind, level)| wanted(**kind, f64::from(**level))).count()
    };
    let outdoor = count(&|kind, _| kind != MASK_BUILDING).max(1);
    let share = 100.0 * count(&is_hole) as f64 / outdoor as f64;

    canvas.text(&format!("{} ({})", record.id, record.split), [MARGIN, MARGIN / 2]);
    let threshold = style.hole_threshold.0;
    let captions = [
        ["height".to_owned(), format!("0 to {highest} m")],
        ["RSRP".to_owned(), format!("{} to {} dBm per RE", RSRP_RANGE[0], RSRP_RANGE[1])],
        [format!("coverage holes below {threshold} dBm"), format!("{share:.1} % of outdoor cells")],
    ];
    for (index, cells) in [heights, rsrp, holes].into_iter().enumerate() {
        let x = MARGIN + index * step;
        let [title, caption] = &captions[index];
        canvas.panel(&cells, [x, top], scale, [title, caption]);
        let [east, north, _] = record.base_station.position_m;
        let pixel = |distance: f64| side as f64 / 2.0 + distance / record.cell_m * scale as f64;
        cross(&mut canvas, [x as f64 + pixel(east), (top + TITLE) as f64 + pixel(-north)]);
    }
    canvas.bar([MARGIN, bar_y], side, height_color);
    canvas.bar([MARGIN + step, bar_y], side, rsrp_color);
    canvas.into_png()
}

fn shade(grids: &Grids, color: impl Fn(u8, f64) -> Rgb) -> Array2<Rgb> {
    let mut cells = Array2::from_elem(grids.mask.dim(), WHITE);
    ndarray::Zip::from(&mut cells)
        .and(&grids.mask)
        .and(&grids.rsrp_dbm)
        .for_each(|cell, &kind, &level| *cell = color(kind, f64::from(level)));
    cells
}

fn height_color(share: f64) -> Rgb {
    // The darkest tenth of the map is left to the outlines of low buildings.
    INFERNO.eval_continuous(0.9 * (1.0 - share.clamp(0.0, 1.0))).as_array()
}

fn rsrp_color(share: f64) -> Rgb {
    VIRIDIS.eval_continuous(share.clamp(0.0, 1.0)).as_array()
}

fn cross(canvas: &mut Canvas, [x, y]: [f64; 2]) {
    for (arm, color) in [(6_i32, INK), (5, STATION)] {
        for offset in -arm..=arm {
            for width in [-1 - i32::from(color == INK), 0, 1 + i32::from(color == INK)] {
                for (dx, dy) in [(offset, width), (width, offset)] {
                    let (px, py) = (x + f64::from(dx), y + f64::from(dy));
                    if px >= 0.0 && py >= 0.0 {
                        canvas.set(px as usize, py as usize, color);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::example;
    use super::*;

    #[test]
    fn the_picture_shows_hole_building_and_cover() {
        let (record, grids) = example();
        let png = panels_png(&record, &grids, PanelStyle { scale: 16, ..PanelStyle::default() });
        let decoder = png::Decoder::new(std::io::Cursor::new(&png));
        let mut reader = decoder.read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
        let info = reader.next_frame(&mut pixels).expect("a frame");
        let third = MARGIN + 2 * (32 + MARGIN);
        let color = |row: usize, column: usize| {
            let (x, y) = (third + column * 16 + 1, MARGIN + 2 * TITLE + row * 16 + 1);
            let at = 3 * (y * info.width as usize + x);
            [pixels[at], pixels[at + 1], pixels[at + 2]]
        };
        assert_eq!([color(0, 0), color(0, 1), color(1, 0)], [COVERED, BUILDING, HOLE]);
        assert_eq!(
            png,
            panels_png(&record, &grids, PanelStyle { scale: 16, ..PanelStyle::default() })
        );
    }
}
