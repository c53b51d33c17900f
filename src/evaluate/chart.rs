//! Line charts as SVG by own code, and as PNG made of the same SVG.
//!
//! Colour tells the family of a series (a method), dashes and marker tell its variant (a number of
//! steps). The same chart gives the same bytes on every machine: numbers have fixed decimals, and
//! the PNG is set in a font that comes with the program.

use notosans::{BOLD_TTF, REGULAR_TTF};
use resvg::{tiny_skia, usvg};

/// Mostly Okabe and Ito's and Tol's colours, which colour-blind readers tell apart; look-alikes
/// are far from each other in the order, for seventeen cannot all differ.
const PALETTE: [&str; 17] = [
    "#0072b2", "#e69f00", "#117733", "#cc79a7", "#cc3311", "#56b4e9", "#999933", "#000000",
    "#882255", "#44aa99", "#332288", "#888888", "#ddcc77", "#661100", "#6699cc", "#aa4499",
    "#009e73",
];
const DASHES: [&str; 5] = ["none", "7 3", "2 3", "8 3 2 3", "14 4"];
const INK: &str = "#222222";
const GRID: &str = "#e4e4e4";
const FONT: &str = "Noto Sans, Helvetica, Arial, sans-serif";

const LEFT: f64 = 66.0;
const TOP: f64 = 44.0;
const PLOT_WIDTH: f64 = 640.0;
const PLOT_HEIGHT: f64 = 430.0;
const RIGHT: f64 = LEFT + PLOT_WIDTH;
const BOTTOM: f64 = TOP + PLOT_HEIGHT;
const HEIGHT: f64 = BOTTOM + 58.0;
/// Space around the plot in which markers at its border are not cut.
const BLEED: f64 = 6.0;

const ROW: f64 = 19.0;
const SAMPLE: f64 = 46.0;
/// Entries in a column of the legend.
const ROWS: usize = 22;
/// Mean width of a letter of the legend, in pixels; a little more than the font's.
const LETTER: f64 = 6.4;
const MAX_MARKERS: usize = 10;

/// A value with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// Where it is on the x axis.
    pub(crate) x: f64,
    /// The value.
    pub(crate) mean: f64,
    /// Lower end of the 95 % interval.
    pub(crate) low: f64,
    /// Upper end of the 95 % interval.
    pub(crate) high: f64,
}

/// One line of a chart.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Series {
    /// Its name in the legend.
    pub(crate) label: String,
    /// Points by ascending x; those that are not finite are left out.
    pub(crate) points: Vec<Point>,
    /// Which colour.
    pub(crate) family: usize,
    /// Which dashes and marker.
    pub(crate) variant: usize,
}

/// Lines over one x axis, with shaded intervals; y begins at zero.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LineChart {
    /// Heading.
    pub(crate) title: String,
    /// Name of the x axis.
    pub(crate) x_label: String,
    /// Name of the y axis.
    pub(crate) y_label: String,
    /// Upper end of the y axis; by default a round number above all intervals.
    pub(crate) y_max: Option<f64>,
    /// Whether x is logarithmic; points at x ≤ 0 are then left out.
    pub(crate) log_x: bool,
    /// Whether the lines are histograms: each value holds half the way to its neighbours, without
    /// interval and marker.
    pub(crate) steps: bool,
    /// The lines; later ones are drawn over earlier ones.
    pub(crate) series: Vec<Series>,
}

impl LineChart {
    /// The chart as an SVG document.
    ///
    /// Each series is a `<g class="series">` with `data-label`, `data-family` and `data-variant`,
    /// its legend entry a `<g class="legend-entry">` with the same attributes.
    #[must_use]
    pub(crate) fn to_svg(&self) -> String {
        let lines: Vec<Vec<Point>> = self.series.iter().map(|line| self.drawn(line)).collect();
        let plot = Plot::new(self, &lines);
        let (legend, width) = self.legend();
        let bands: String = if self.steps {
            String::new()
        } else {
            self.each(&lines, |line, points| plot.band(line, points))
        };
        let intervals = if self.steps { "" } else { ", with shaded 95 % intervals" };
        let curves: String = self.each(&lines, |line, points| plot.curve(line, points));
        let [title, x_label, y_label] =
            [&self.title, &self.x_label, &self.y_label].map(|text| escape(text));
        let axes = plot.axes(&x_label, &y_label);
        let (view_x, view_y) = (LEFT - BLEED, TOP - BLEED);
        let (view_width, view_height) = (PLOT_WIDTH + 2.0 * BLEED, PLOT_HEIGHT + 2.0 * BLEED);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"chart\" role=\"img\" \
             width=\"{width}\" height=\"{HEIGHT}\" viewBox=\"0 0 {width} {HEIGHT}\" \
             font-family=\"{FONT}\" font-size=\"12\" fill=\"{INK}\">\n\
             <title>{title}</title>\n\
             <desc>Line chart of {y_label} against {x_label}: {count} series\
             {intervals}.</desc>\n\
             <rect width=\"{width}\" height=\"{HEIGHT}\" fill=\"#ffffff\"/>\n\
             <text x=\"{LEFT}\" y=\"26\" font-size=\"16\" font-weight=\"bold\">{title}</text>\n\
             {axes}\
             <svg x=\"{view_x}\" y=\"{view_y}\" width=\"{view_width}\" height=\"{view_height}\" \
             viewBox=\"{view_x} {view_y} {view_width} {view_height}\">\n{bands}{curves}</svg>\n\
             <g class=\"legend\">\n{legend}</g>\n</svg>\n",
            count = self.series.len(),
        )
    }

    /// The legend right of the plot, and where it ends.
    fn legend(&self) -> (String, f64) {
        let columns = self.series.len().div_ceil(ROWS).max(1);
        let rows = self.series.len().div_ceil(columns).max(1);
        let mut x = RIGHT + 26.0;
        let mut legend = String::new();
        for column in self.series.chunks(rows) {
            let longest = column.iter().map(|line| line.label.chars().count()).max().unwrap_or(0);
            let width = SAMPLE + longest as f64 * LETTER;
            for (row, line) in column.iter().enumerate() {
                legend += &legend_entry(line, x, TOP + 8.0 + row as f64 * ROW, width);
            }
            x += width + 14.0;
        }
        (legend, x.ceil())
    }

    /// The points that can be drawn.
    fn drawn(&self, line: &Series) -> Vec<Point> {
        let finite = |point: &&Point| {
            point.x.is_finite() && point.mean.is_finite() && (point.x > 0.0 || !self.log_x)
        };
        let ends = |point: &Point| {
            let [low, high] =
                [point.low, point.high].map(|end| if end.is_finite() { end } else { point.mean });
            Point { low, high, ..*point }
        };
        let points: Vec<Point> = line.points.iter().filter(finite).map(ends).collect();
        if self.steps { steps(&points) } else { points }
    }

    fn each(&self, lines: &[Vec<Point>], draw: impl Fn(&Series, &[Point]) -> String) -> String {
        self.series.iter().zip(lines).map(|(line, points)| draw(line, points)).collect()
    }
}

/// Where values lie on the picture.
struct Plot {
    x_range: [f64; 2],
    y_max: f64,
    log_x: bool,
    steps: bool,
    /// Of the bands: where those of many lines lie over each other, the lines stay visible.
    opacity: f64,
}

impl Plot {
    fn new(chart: &LineChart, lines: &[Vec<Point>]) -> Self {
        let points = || lines.iter().flatten();
        let first = points().map(|point| point.x).fold(f64::INFINITY, f64::min);
        let last = points().map(|point| point.x).fold(f64::NEG_INFINITY, f64::max);
        let top = points().map(|point| point.high.max(point.mean)).fold(0.0, f64::max);
        let x_range = match (chart.log_x, first < last) {
            // Nearly from zero on is from zero on.
            (false, true) if first > 0.0 && first < 0.25 * last => [0.0, last],
            (_, true) => [first, last],
            // One point, or none.
            (false, false) if first.is_finite() => [first - 1.0, first + 1.0],
            (true, false) if first.is_finite() => [first / 2.0, first * 2.0],
            (false, false) => [0.0, 1.0],
            (true, false) => [1.0, 10.0],
        };
        let chosen = chart.y_max.filter(|y_max| y_max.is_finite() && *y_max > 0.0);
        let y_max = chosen.unwrap_or_else(|| nice_ceiling(top));
        let opacity = (0.9 / lines.len().max(1) as f64).clamp(0.02, 0.12);
        Self { x_range, y_max, log_x: chart.log_x, steps: chart.steps, opacity }
    }

    fn x(&self, value: f64) -> f64 {
        let scale = |x: f64| if self.log_x { libm::log10(x) } else { x };
        let [from, to] = self.x_range.map(scale);
        LEFT + PLOT_WIDTH * (scale(value) - from) / (to - from)
    }

    fn y(&self, value: f64) -> f64 {
        BOTTOM - PLOT_HEIGHT * value / self.y_max
    }

    fn place(&self, x: f64, y: f64) -> String {
        format!("{:.2},{:.2}", self.x(x), self.y(y))
    }

    fn axes(&self, x_label: &str, y_label: &str) -> String {
        let [from, to] = self.x_range;
        let x_ticks = if self.log_x { log_ticks(from, to) } else { ticks(from, to) };
        let vertical = x_ticks.iter().map(|(value, text)| {
            let (x, y) = (self.x(*value), BOTTOM + 18.0);
            format!(
                "<path d=\"M{x:.2} {TOP}V{BOTTOM}\" stroke=\"{GRID}\"/>\
                 <text x=\"{x:.2}\" y=\"{y}\" text-anchor=\"middle\">{text}</text>\n"
            )
        });
        let y_ticks = ticks(0.0, self.y_max);
        let horizontal = y_ticks.iter().map(|(value, text)| {
            let (x, y) = (LEFT - 8.0, self.y(*value));
            let baseline = y + 4.2;
            format!(
                "<path d=\"M{LEFT} {y:.2}H{RIGHT}\" stroke=\"{GRID}\"/>\
                 <text x=\"{x}\" y=\"{baseline:.2}\" text-anchor=\"end\">{text}</text>\n"
            )
        });
        let lines: String = vertical.chain(horizontal).collect();
        let (x, y) = (LEFT + PLOT_WIDTH / 2.0, TOP + PLOT_HEIGHT / 2.0);
        format!(
            "<g class=\"axes\">\n{lines}\
             <path d=\"M{LEFT} {TOP}V{BOTTOM}H{RIGHT}\" fill=\"none\" stroke=\"{INK}\"/>\n\
             <text x=\"{x}\" y=\"{bottom}\" font-size=\"13\" \
             text-anchor=\"middle\">{x_label}</text>\n\
             <text transform=\"translate(18 {y}) rotate(-90)\" font-size=\"13\" \
             text-anchor=\"middle\">{y_label}</text>\n</g>\n",
            bottom = BOTTOM + 42.0,
        )
    }

    /// The shaded interval of a line; bands lie below all lines.
    fn band(&self, line: &Series, points: &[Point]) -> String {
        if points.len() < 2 {
            return String::new();
        }
        let upper = points.iter().map(|point| self.place(point.x, point.high));
        let lower = points.iter().rev().map(|point| self.place(point.x, point.low));
        let outline: Vec<String> = upper.chain(lower).collect();
        format!(
            "<polygon class=\"band\" {data} points=\"{}\" fill=\"{}\" fill-opacity=\"{:.3}\"/>\n",
            outline.join(" "),
            color(line),
            self.opacity,
            data = data(line),
        )
    }

    fn curve(&self, line: &Series, points: &[Point]) -> String {
        let corners: Vec<String> =
            points.iter().map(|point| self.place(point.x, point.mean)).collect();
        let path = format!("M{}", corners.join("L"));
        // Families begin at different points, so that their markers hide each other less.
        let stride = points.len().div_ceil(MAX_MARKERS).max(1);
        let markers: String = points
            .iter()
            .enumerate()
            .filter(|_| !self.steps)
            .filter(|(index, _)| (index + line.family % stride).is_multiple_of(stride))
            .map(|(_, point)| marker(line, self.x(point.x), self.y(point.mean)))
            .collect();
        let stroke = if points.len() < 2 { String::new() } else { stroke(line, &path) };
        format!(
            "<g class=\"series\" {data}><title>{label}</title>{stroke}{markers}</g>\n",
            data = data(line),
            label = escape(&line.label),
        )
    }
}

/// The outline of a histogram whose bins have these centres, all of one width.
fn steps(points: &[Point]) -> Vec<Point> {
    let half = points.windows(2).next().map_or(0.5, |pair| (pair[1].x - pair[0].x) / 2.0);
    let edges = |point: &Point| [-half, half].map(|dx| Point { x: point.x + dx, ..*point });
    points.iter().flat_map(edges).collect()
}

fn color(line: &Series) -> &'static str {
    PALETTE[line.family % PALETTE.len()]
}

fn data(line: &Series) -> String {
    let Series { label, family, variant, .. } = line;
    let (label, color) = (escape(label), color(line));
    format!(
        "data-label=\"{label}\" data-family=\"{family}\" data-variant=\"{variant}\" \
         data-color=\"{color}\""
    )
}

fn stroke(line: &Series, path: &str) -> String {
    let (color, dashes) = (color(line), DASHES[line.variant % DASHES.len()]);
    format!(
        "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.7\" \
         stroke-linejoin=\"round\" stroke-dasharray=\"{dashes}\"/>"
    )
}

/// A circle, square, triangle, diamond or hollow circle.
fn marker(line: &Series, x: f64, y: f64) -> String {
    let color = color(line);
    let polygon = |corners: &[[f64; 2]]| {
        let corners: Vec<String> =
            corners.iter().map(|[dx, dy]| format!("{:.2},{:.2}", x + dx, y + dy)).collect();
        let points = corners.join(" ");
        format!("<polygon points=\"{points}\" fill=\"{color}\" stroke=\"#ffffff\"/>")
    };
    match line.variant % DASHES.len() {
        0 => format!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"3.4\" fill=\"{color}\" stroke=\"#ffffff\"/>"
        ),
        1 => polygon(&[[-3.3, -3.3], [3.3, -3.3], [3.3, 3.3], [-3.3, 3.3]]),
        2 => polygon(&[[0.0, -4.6], [4.3, 3.2], [-4.3, 3.2]]),
        3 => polygon(&[[0.0, -4.8], [4.8, 0.0], [0.0, 4.8], [-4.8, 0.0]]),
        _ => format!(
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"3.2\" fill=\"#ffffff\" stroke=\"{color}\" \
             stroke-width=\"1.6\"/>"
        ),
    }
}

fn legend_entry(line: &Series, x: f64, y: f64, width: f64) -> String {
    let path = format!("M{x:.2} {y:.2}h{:.2}", SAMPLE - 8.0);
    format!(
        "<g class=\"legend-entry\" {data}><rect x=\"{x:.2}\" y=\"{top:.2}\" width=\"{width:.2}\" \
         height=\"{ROW}\" fill=\"#ffffff\"/>{stroke}{marker}\
         <text x=\"{text_x:.2}\" y=\"{baseline:.2}\">{label}</text></g>\n",
        data = data(line),
        top = y - ROW / 2.0,
        stroke = stroke(line, &path),
        marker = marker(line, x + (SAMPLE - 8.0) / 2.0, y),
        text_x = x + SAMPLE,
        baseline = y + 4.2,
        label = escape(&line.label),
    )
}

/// The text in XML; characters that XML cannot hold are left out.
fn escape(text: &str) -> String {
    text.replace(|letter: char| letter.is_control() || "\u{fffe}\u{ffff}".contains(letter), "")
        .replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// The round step (1, 2 or 5 times a power of ten) that divides a length into 4 to 10 parts, and
/// the decimals that it needs.
fn step(length: f64) -> (f64, usize) {
    let magnitude = libm::floor(libm::log10(length / 4.0));
    let power = libm::pow(10.0, magnitude);
    let leading = length / 4.0 / power;
    let factor = if leading >= 5.0 {
        5.0
    } else if leading >= 2.0 {
        2.0
    } else {
        1.0
    };
    (factor * power, (-magnitude).max(0.0) as usize)
}

/// The next multiple of the round step.
fn nice_ceiling(top: f64) -> f64 {
    if top <= 0.0 {
        return 1.0;
    }
    let (step, _) = step(top);
    step * libm::ceil(top / step - 1e-9)
}

/// Round values between two others, with their texts.
fn ticks(from: f64, to: f64) -> Vec<(f64, String)> {
    let (step, decimals) = step(to - from);
    let first = libm::ceil(from / step - 1e-9) as i64;
    let last = libm::floor(to / step + 1e-9) as i64;
    (first..=last)
        .map(|index| index as f64 * step)
        .map(|value| (value, format!("{value:.decimals$}")))
        .collect()
}

/// 1, 2 and 5 times the powers of ten between two values.
fn log_ticks(from: f64, to: f64) -> Vec<(f64, String)> {
    let decades = libm::floor(libm::log10(from)) as i32..=libm::ceil(libm::log10(to)) as i32;
    let marks = decades.flat_map(|decade| {
        let decimals = usize::try_from(-decade).unwrap_or(0);
        [1.0, 2.0, 5.0].map(|factor| {
            let value = factor * libm::pow(10.0, f64::from(decade));
            (value, format!("{value:.decimals$}"))
        })
    });
    marks.filter(|(value, _)| (from * 0.999..=to * 1.001).contains(value)).collect()
}

/// Draws an SVG of [`LineChart::to_svg`], in the program's own font; `scale` is clamped to 0.25
/// to 8 pixels a unit.
///
/// # Panics
/// For a text that is no SVG.
#[must_use]
pub(crate) fn svg_to_png(svg: &str, scale: f32) -> Vec<u8> {
    let mut options = usvg::Options { font_family: "Noto Sans".to_owned(), ..Default::default() };
    for font in [REGULAR_TTF, BOLD_TTF] {
        options.fontdb_mut().load_font_data(font.to_vec());
    }
    let tree = usvg::Tree::from_str(svg, &options).expect("an SVG of this module");
    let scale = scale.clamp(0.25, 8.0);
    let [width, height] =
        [tree.size().width(), tree.size().height()].map(|side| (side * scale).ceil() as u32);
    let mut pixmap = tiny_skia::Pixmap::new(width, height).expect("sides are not zero");
    let transform = tiny_skia::Transform::from_scale(scale, scale);
    resvg::render(&tree, transform, &mut pixmap.as_mut());
    pixmap.encode_png().expect("writing to memory cannot fail")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, mean: f64) -> Point {
        Point { x, mean, low: mean - 0.05, high: mean + 0.05 }
    }

    fn series(label: &str, points: Vec<Point>) -> Series {
        Series { label: label.to_owned(), points, family: 1, variant: 2 }
    }

    fn chart(series: Vec<Series>) -> LineChart {
        LineChart {
            title: "Precision".to_owned(),
            x_label: "starts".to_owned(),
            y_label: "precision".to_owned(),
            y_max: None,
            log_x: false,
            steps: false,
            series,
        }
    }

    /// Parses the SVG and counts the groups of a class.
    fn count(svg: &str, class: &str) -> usize {
        let document = usvg::roxmltree::Document::parse(svg).expect("well-formed");
        document.descendants().filter(|node| node.attribute("class") == Some(class)).count()
    }

    fn texts(ticks: Vec<(f64, String)>) -> Vec<String> {
        ticks.into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn labels_are_escaped_and_found_again() {
        let label = "a < b & \"c\" > 'd'\u{1}";
        let svg = chart(vec![series(label, vec![point(1.0, 0.2), point(2.0, 0.4)])]).to_svg();
        let document = usvg::roxmltree::Document::parse(&svg).expect("well-formed");
        let labels: Vec<_> =
            document.descendants().filter_map(|node| node.attribute("data-label")).collect();
        assert_eq!(labels, ["a < b & \"c\" > 'd'"; 3], "band, series and legend entry");
    }

    #[test]
    fn a_full_chart_is_well_formed_and_the_same_twice() {
        let lines = (0..35).map(|index| Series {
            family: index % 12,
            variant: index / 12,
            ..series(
                &format!("method {index}"),
                (0..20).map(|x| point(f64::from(x), 0.5)).collect(),
            )
        });
        let chart = chart(lines.collect());
        let svg = chart.to_svg();
        assert_eq!(
            [count(&svg, "series"), count(&svg, "legend-entry"), count(&svg, "band")],
            [35; 3]
        );
        assert_eq!(svg, chart.to_svg());
        assert_eq!(svg_to_png(&svg, 1.0), svg_to_png(&svg, 1.0));
    }

    #[test]
    fn the_png_has_the_scaled_size_and_letters() {
        let svg = chart(vec![series("line", vec![point(1.0, 0.2), point(2.0, 0.4)])]).to_svg();
        let decode = |svg: &str, scale: f32| {
            let bytes = svg_to_png(svg, scale);
            let mut reader =
                png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("a PNG");
            let mut pixels = vec![0; reader.output_buffer_size().expect("small")];
            let info = reader.next_frame(&mut pixels).expect("a frame");
            (info.width, info.height, pixels)
        };
        let (width, height, pixels) = decode(&svg, 1.0);
        assert_eq!(height, HEIGHT as u32);
        let (double_width, double_height, _) = decode(&svg, 2.0);
        assert_eq!([double_width, double_height], [2 * width, 2 * height]);
        let without_title = svg.replace("font-weight=\"bold\">Precision", "font-weight=\"bold\">");
        assert!(decode(&without_title, 1.0).2 != pixels, "no letters were drawn");
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out() {
        let broken = vec![point(f64::NAN, 0.1), point(1.0, f64::NAN), point(2.0, f64::INFINITY)];
        let open = Point { low: f64::NAN, high: f64::NAN, ..point(3.0, 0.3) };
        let cases = [
            vec![],
            vec![series("empty", vec![])],
            vec![series("broken", broken), series("open", vec![open, point(4.0, 0.3)])],
            vec![series("zero", vec![point(0.0, 0.0), point(0.0, 0.0)])],
        ];
        for lines in cases {
            for log_x in [false, true] {
                let chart = LineChart { log_x, ..chart(lines.clone()) };
                let svg = chart.to_svg();
                assert_eq!(count(&svg, "series"), lines.len());
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
                assert!(!svg_to_png(&svg, 0.5).is_empty());
            }
        }
    }

    #[test]
    fn one_point_is_a_marker_without_a_line() {
        let svg = chart(vec![series("one", vec![point(5.0, 0.5)])]).to_svg();
        let drawn = svg.split("class=\"series\"").nth(1).expect("one series");
        let drawn = drawn.split("</g>").next().expect("its content");
        assert!(drawn.contains("<polygon") && !drawn.contains("<path"), "{drawn}");
        assert_eq!(count(&svg, "band"), 0);
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(texts(ticks(0.0, 1.0)), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(texts(ticks(0.0, 200.0)), ["0", "50", "100", "150", "200"]);
        assert_eq!(texts(ticks(0.0, 0.04)), ["0.00", "0.01", "0.02", "0.03", "0.04"]);
        assert_eq!(texts(ticks(-1.0, 1.0)), ["-1.0", "-0.5", "0.0", "0.5", "1.0"]);
        assert_eq!(texts(log_ticks(1.0, 200.0)), ["1", "2", "5", "10", "20", "50", "100", "200"]);
        assert_eq!(texts(log_ticks(0.5, 2.0)), ["0.5", "1", "2"]);
        assert_eq!(nice_ceiling(0.93), 1.0);
        assert_eq!(nice_ceiling(0.8), 0.8);
        assert_eq!(nice_ceiling(0.0), 1.0);
    }

    #[test]
    fn a_histogram_is_an_outline_without_bands_and_markers() {
        let line = vec![series("line", vec![point(1.0, 0.2), point(2.0, 0.4)])];
        let svg = LineChart { steps: true, ..chart(line) }.to_svg();
        assert_eq!(count(&svg, "band"), 0);
        let drawn = svg.split("class=\"series\"").nth(1).expect("one series");
        let drawn = drawn.split("</g>").next().expect("its content");
        let path = drawn.split("d=\"").nth(1).and_then(|rest| rest.split('"').next());
        assert_eq!(path.map(|path| path.matches(['M', 'L']).count()), Some(4), "{drawn}");
        assert!(!drawn.contains("<polygon"), "{drawn}");
    }

    #[test]
    fn the_chosen_ceiling_wins() {
        let line = vec![series("line", vec![point(1.0, 0.2), point(2.0, 0.4)])];
        let svg = LineChart { y_max: Some(1.0), ..chart(line) }.to_svg();
        assert!(svg.contains(">0.8</text>") && svg.contains(">1.0</text>"));
    }
}
