//! Figures: observed return and performance side by side over steps, and settings compared in a sweep.
//!
//! A [`Figure`] is data; drawing it gives the same bytes for the same data. Series differ in colour,
//! in dash and in marker, so that none of the three is needed to tell them apart.

pub(super) mod axis;
mod draw;

use std::fmt::Write as _;

use anyhow::{Context as _, ensure};
use mcvl_core::config::Config;
use mcvl_core::record::Arm;
use resvg::{tiny_skia, usvg};

use super::claims::Summary;
use super::csv_field;
use super::statistics::{self, CurvePoint, Estimate, Quantity};
use crate::runs::RunSet;

/// A drawing of one or more panels with one legend above them.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What it shows, for those who do not see it.
    pub title: String,
    /// What is to be seen in it, likewise.
    pub description: String,
    /// How to read it, beside the legend.
    pub note: String,
    /// Panels, from left to right, then downwards.
    pub panels: Vec<Panel>,
    /// Panels side by side; 0 for all of them.
    pub columns: usize,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Title above the axes.
    pub title: String,
    /// Title of the vertical axis, with unit.
    pub y_title: String,
    /// The horizontal axis.
    pub x: Horizontal,
    /// Series; those of one name have one look and one legend entry over all panels.
    pub series: Vec<Series>,
    /// Values that data are to be compared with, named at the right edge.
    pub references: Vec<Reference>,
}

/// A horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub enum Horizontal {
    /// Numbers.
    Steps {
        /// Title with unit; they begin at 0, or at the least step there is.
        title: String,
        /// Where Safe training ends and the Full world begins.
        switch: Option<f64>,
    },
    /// Named settings; a series' x counts them from 0.
    Settings {
        /// Title.
        title: String,
        /// Names.
        names: Vec<String>,
    },
}

/// One series.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Of which leg.
    pub leg: Arm,
    /// Seeds behind it; the most that a setting has.
    pub count: usize,
    /// Look: 0 Safe, 1 baseline, 2 mc, then further ones.
    pub look: usize,
    /// Mean and interval at each x.
    pub points: Vec<Point>,
    /// Single seeds, as (x, y): drawn as dots.
    pub seeds: Vec<(f64, f64)>,
}

/// Mean and interval at one x.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Where.
    pub x: f64,
    /// Mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Point {
    /// An estimate at `x`.
    pub fn new(x: f64, estimate: &Estimate) -> Self {
        Self { x, mean: estimate.mean, low: estimate.low, high: estimate.high }
    }
}

/// A horizontal line with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Where.
    pub y: f64,
    /// What it is.
    pub name: String,
}

/// How panels are arranged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Side by side: paper and wide screens.
    Row,
    /// One above the other, narrower: phones.
    Column,
}

impl Figure {
    /// The figure as an SVG that stands alone, on a light background.
    pub fn svg(&self) -> String {
        draw::figure(self, Layout::Row, false)
    }

    /// What is drawn, as CSV: a line for each point of each series.
    pub fn csv(&self) -> String {
        let mut text = String::from("panel,series,leg,seeds,x,mean,low,high\n");
        for panel in &self.panels {
            for series in &panel.series {
                let head = [&panel.title, &series.name].map(|name| csv_field(name)).join(",");
                let (leg, seeds) = (series.leg.name(), series.count);
                for Point { x, mean, low, high } in &series.points {
                    let _ = writeln!(text, "{head},{leg},{seeds},{x},{mean},{low},{high}");
                }
            }
        }
        text
    }

    /// The figure as a part of the report page, which brings its style and its colours.
    pub(super) fn inline(&self, layout: Layout) -> String {
        draw::figure(self, layout, true)
    }

    /// The figure as a PNG, `scale` pixels per unit (2 suits a screen, 3 print).
    ///
    /// # Errors
    /// If the scale is not above 0 and at most 8.
    pub fn png(&self, scale: f32) -> anyhow::Result<Vec<u8>> {
        raster(&self.svg(), scale)
    }
}

/// An SVG as PNG. The only font is the embedded one, so that every machine draws the same.
pub(super) fn raster(svg: &str, scale: f32) -> anyhow::Result<Vec<u8>> {
    ensure!(scale > 0.0 && scale <= 8.0, "scale {scale} is out of range: above 0 and at most 8");
    let mut options = usvg::Options::default();
    options.fontdb_mut().load_font_data(dejavu::sans::regular().to_vec());
    options.font_family = "DejaVu Sans".into();
    let tree = usvg::Tree::from_str(svg, &options).context("the figure is not well-formed SVG")?;
    let size = tree.size().to_int_size().scale_by(scale).context("the figure has no size")?;
    let mut pixels = tiny_skia::Pixmap::new(size.width(), size.height()).context("the figure is too large")?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().context("cannot encode the figure as PNG")
}

/// The curves of a run directory: observed return and performance over the steps of both phases.
pub fn curves(set: &RunSet) -> Figure {
    let experiment = set.config.experiment();
    let summary = Summary::new(set);
    let panel = |quantity: Quantity| Panel {
        title: name_of(quantity).into(),
        y_title: unit_of(quantity).into(),
        x: Horizontal::Steps {
            title: "environment steps, both phases".into(),
            switch: (set.config.safe_steps > 0).then(|| f64::from(set.config.safe_steps)),
        },
        series: Arm::ALL.into_iter().filter_map(|arm| leg_series(set, arm, quantity)).collect(),
        references: references(&set.config, quantity),
    };
    Figure {
        title: format!("{}: observed return and performance over environment steps", experiment.title),
        description: describe(&summary),
        note: match set.seeds.len() {
            1 => "one seed".into(),
            count => format!("mean of {count} seeds, band: its 95 % interval"),
        },
        panels: vec![panel(Quantity::Return), panel(Quantity::Performance)],
        columns: 0,
    }
}

/// End values of several run directories, one setting each: mean, interval, and every seed as a dot.
pub fn sweep(sets: &[(String, &RunSet)]) -> Figure {
    let summaries: Vec<Summary> = sets.iter().map(|(_, set)| Summary::new(set)).collect();
    let names: Vec<String> = sets.iter().map(|(name, _)| name.clone()).collect();
    let panel = |quantity: Quantity| Panel {
        title: format!("{} at the end", name_of(quantity)),
        y_title: unit_of(quantity).into(),
        x: Horizontal::Settings { title: "setting".into(), names: names.clone() },
        series: Arm::ALL[1..].iter().filter_map(|arm| end_series(&summaries, *arm, quantity)).collect(),
        // Lines across all of them are of all of them.
        references: match sets {
            [(_, first), others @ ..] if others.iter().all(|(_, set)| set.config.optima() == first.config.optima()) => {
                references(&first.config, quantity)
            }
            _ => Vec::new(),
        },
    };
    let told = names.iter().zip(&summaries).map(|(name, summary)| format!("{name}: {}", describe(summary)));
    Figure {
        title: "Observed return and performance at the end, by setting".into(),
        description: told.collect::<Vec<_>>().join(" "),
        note: "dots: seeds, bar: mean, line: its 95 % interval".into(),
        panels: vec![panel(Quantity::Return), panel(Quantity::Performance)],
        columns: 0,
    }
}

pub(crate) fn name_of(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Return => "Observed return",
        Quantity::Performance => "Performance",
    }
}

pub(crate) fn unit_of(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Return => "observed reward per episode",
        Quantity::Performance => "hidden reward per episode",
    }
}

/// Name of a leg in legends.
pub(crate) fn legend_of(arm: Arm) -> &'static str {
    match arm {
        Arm::Safe => "Safe training (shared)",
        Arm::Baseline => "plain learner",
        Arm::Mc => "modification-considering",
        Arm::Oracle => "oracle",
        Arm::Frozen => "frozen",
        Arm::FrozenReward => "frozen reward model",
    }
}

/// Index of a leg's look.
pub(crate) fn look_of(arm: Arm) -> usize {
    match arm {
        Arm::Safe => 0,
        Arm::Baseline => 1,
        Arm::Mc => 2,
        Arm::Oracle => 3,
        Arm::Frozen => 4,
        Arm::FrozenReward => 5,
    }
}

fn leg_series(set: &RunSet, arm: Arm, quantity: Quantity) -> Option<Series> {
    let start = if arm == Arm::Safe { 0 } else { set.config.safe_steps };
    let curve = statistics::curve(&set.seeds, arm, quantity);
    let point = |at: &CurvePoint| Point::new(f64::from(start) + f64::from(at.step), &at.estimate);
    let points: Vec<Point> = curve.iter().map(point).collect();
    (!points.is_empty()).then(|| series_of(arm, set.seeds.len(), points, Vec::new()))
}

fn end_series(summaries: &[Summary], arm: Arm, quantity: Quantity) -> Option<Series> {
    let (mut points, mut seeds, mut count) = (Vec::new(), Vec::new(), 0);
    for (x, leg) in summaries.iter().enumerate().filter_map(|(x, summary)| Some((x as f64, summary.arm(arm)?))) {
        count = count.max(leg.seeds.len());
        match quantity {
            Quantity::Return => {
                points.push(Point::new(x, &leg.observed_return));
                seeds.extend(leg.seeds.iter().map(|seed| (x, seed.observed_return)));
            }
            Quantity::Performance => {
                points.push(Point::new(x, &leg.performance));
                seeds.extend(leg.seeds.iter().map(|seed| (x, seed.performance)));
            }
        }
    }
    (!points.is_empty()).then(|| series_of(arm, count, points, seeds))
}

/// A leg with its own name and look.
fn series_of(leg: Arm, count: usize, points: Vec<Point>, seeds: Vec<(f64, f64)>) -> Series {
    Series { name: legend_of(leg).into(), leg, look: look_of(leg), count, points, seeds }
}

/// The optima that the experiment's table knows.
pub(crate) fn references(config: &Config, quantity: Quantity) -> Vec<Reference> {
    let Some(optima) = config.optima() else { return Vec::new() };
    let reference = |y: f64, name: &str| Reference { y, name: name.into() };
    let mut list = vec![reference(optima.intended, "intended")];
    // One line, one name.
    if optima.safe_best != optima.intended {
        list.insert(0, reference(optima.safe_best, "best in Safe"));
    }
    if let Some((observed, performance)) = optima.hacking {
        let y = if quantity == Quantity::Return { observed } else { performance };
        list.push(reference(y, "full hack"));
    }
    list
}

/// The end of every leg in words.
fn describe(summary: &Summary) -> String {
    let told = summary.arms.iter().map(|leg| {
        let (observed, performance) = (leg.observed_return.mean, leg.performance.mean);
        format!("{} ends at observed return {observed:.1}, performance {performance:.1}.", legend_of(leg.arm))
    });
    let told: Vec<String> = told.collect();
    if told.is_empty() { "No leg is finished yet.".into() } else { told.join(" ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples::{self, Outcome};

    #[test]
    fn the_same_runs_give_the_same_bytes() {
        assert_eq!(curves(&samples::ten()).svg(), curves(&samples::ten()).svg());
    }

    #[test]
    fn legs_follow_each_other_on_one_axis() {
        let figure = curves(&samples::ten());
        let ends: Vec<_> =
            figure.panels[0].series.iter().map(|s| (s.points[0].x, s.points.last().unwrap().x)).collect();
        assert_eq!(ends, [(0.0, 1000.0), (1000.0, 2000.0), (1000.0, 2000.0)]);
        assert_eq!(figure.panels[1].references[2], Reference { y: -49.0, name: "full hack".into() });
    }

    #[test]
    fn sweeps_keep_every_seed() {
        let (few, many) = (samples::set(&[Outcome::Missed; 3]), samples::ten());
        let figure = sweep(&[("100".into(), &few), ("1000".into(), &many)]);
        let mc = &figure.panels[1].series[1];
        assert_eq!((mc.seeds.len(), mc.points.len(), mc.points[0].mean), (13, 2, -49.0));
        assert_eq!(mc.seeds[0], (0.0, -49.0));
    }

    #[test]
    fn pictures_are_png_of_the_asked_size() {
        let figure = curves(&samples::set(&[Outcome::Intended]));
        let size = |scale| {
            let png = figure.png(scale).unwrap();
            assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
            u32::from_be_bytes(png[16..20].try_into().unwrap())
        };
        assert_eq!(size(1.0) * 2, size(2.0));
        assert!(figure.png(0.0).is_err() && figure.png(f32::NAN).is_err());
    }

    #[test]
    fn runs_without_results_still_have_a_figure() {
        let mut set = samples::set(&[Outcome::Intended]);
        set.seeds[0].evaluations.clear();
        assert!(curves(&set).svg().contains("no evaluation yet"));
        assert!(sweep(&[]).svg().contains("no evaluation yet"));
    }

    #[test]
    fn names_are_escaped() {
        let set = samples::ten();
        assert!(sweep(&[("<b>&".into(), &set)]).svg().contains("&lt;b&gt;&amp;"));
    }
}
