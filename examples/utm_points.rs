//! Projects points all over the UTM zones and prints them as CSV, for comparing with
//! another implementation: `cargo run --example utm_points > points.csv`.

#![allow(clippy::print_stdout, reason = "an example prints its result")]

use holescout::crs::Utm;

fn main() {
    println!("epsg,lon,lat,easting,northing,lon_back,lat_back");
    // Golden-ratio steps spread points evenly without a random generator.
    let spread = |index: u32, step: f64| (f64::from(index) * step).fract();
    for index in 0..5000 {
        let (lon, lat) = (
            360.0 * spread(index, 0.618_033_988_7) - 180.0,
            164.0 * spread(index, 0.754_877_666_2) - 80.0,
        );
        let Ok(utm) = Utm::of_place(lon, lat) else {
            continue;
        };
        // Also up to 5° beyond the zone: tiles keep to the zone of their area's centre.
        let lon = lon + 10.0 * spread(index, 0.569_840_290_9) - 5.0;
        let Some([easting, northing]) = utm.forward(lon, lat) else {
            continue;
        };
        let [lon_back, lat_back] = utm.inverse(easting, northing);
        let epsg = utm.epsg();
        println!("{epsg},{lon},{lat},{easting},{northing},{lon_back},{lat_back}");
    }
}
