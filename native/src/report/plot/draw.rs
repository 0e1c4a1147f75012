//! Drawing a figure: the legend, then each panel in its box.

use super::axis::{Scale, label, padded_range};
use super::{Figure, Horizontal, Layout, Panel, Point, Reference, Series};
use crate::report::svg::{Anchor, SERIES, Svg, text_width};

/// Dash of each look; empty is solid.
const DASHES: &[&str] = &["", "8 4", "", "2 3", "10 3 2 3", "5 2", "14 4", "1 3 6 3"];
const TEXT: f64 = 12.5;
const SMALL: f64 = 11.5;
/// Room around the plotting area: tick labels and titles left and below, names of references right.
const LEFT: f64 = 64.0;
const RIGHT: f64 = 92.0;
const TOP: f64 = 62.0;
const BOTTOM: f64 = 50.0;
const LEGEND_ROW: f64 = 24.0;
const KEY: f64 = 34.0;

/// Corner and size of a rectangle.
#[derive(Clone, Copy)]
struct Area {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

impl Area {
    fn right(self) -> f64 {
        self.x + self.width
    }

    fn bottom(self) -> f64 {
        self.y + self.height
    }
}

/// Draws a figure.
pub(super) fn figure(figure: &Figure, layout: Layout, inline: bool) -> String {
    let (panel_width, panel_height, columns) = match layout {
        Layout::Row if figure.columns > 0 => (520.0, 358.0, figure.columns),
        Layout::Row => (520.0, 358.0, figure.panels.len().max(1)),
        Layout::Column => (400.0, 308.0, 1),
    };
    let width = panel_width * columns as f64;
    let mut svg = Svg::new();
    let top = legend(&mut svg, figure, width);
    for (index, panel) in figure.panels.iter().enumerate() {
        let (column, row) = (index % columns, index / columns);
        let (x, y) = (panel_width * column as f64, top + panel_height * row as f64);
        let area =
            Area { x: x + LEFT, y: y + TOP, width: panel_width - LEFT - RIGHT, height: panel_height - TOP - BOTTOM };
        draw_panel(&mut svg, panel, area);
    }
    let rows = figure.panels.len().div_ceil(columns);
    svg.finish((width, top + panel_height * rows as f64), &figure.title, &figure.description, inline)
}

/// Draws the legend above the panels and returns its height.
fn legend(svg: &mut Svg, figure: &Figure, width: f64) -> f64 {
    let mut entries: Vec<&Series> = Vec::new();
    for series in figure.panels.iter().flat_map(|panel| &panel.series) {
        if entries.iter().all(|entry| entry.name != series.name) {
            entries.push(series);
        }
    }
    let (mut x, mut y) = (LEFT, 22.0);
    for series in entries {
        let length = KEY + 8.0 + text_width(&series.name, TEXT) + 20.0;
        if x > LEFT && x + length > width {
            (x, y) = (LEFT, y + LEGEND_ROW);
        }
        if series.seeds.is_empty() {
            let (class, dash) = (format!("f-line s-{}", colour(series.look)), dash(series.look));
            svg.polyline(&class, &[(x, y - 4.0), (x + KEY, y - 4.0)], dash);
        } else {
            marker(svg, "", series.look, (x + KEY / 2.0, y - 4.0), 5.0);
        }
        svg.text("f-text", (x + KEY + 8.0, y), TEXT, Anchor::Start, &series.name);
        x += length;
    }
    if x > LEFT && x + text_width(&figure.note, SMALL) > width {
        (x, y) = (LEFT, y + LEGEND_ROW);
    }
    svg.text("f-soft", (x, y), SMALL, Anchor::Start, &figure.note);
    y + 8.0
}

fn draw_panel(svg: &mut Svg, panel: &Panel, area: Area) {
    let values = panel.series.iter().flat_map(|series| {
        let bands = series.points.iter().flat_map(|point| [point.low, point.high]);
        bands.chain(series.seeds.iter().map(|seed| seed.1))
    });
    let (low, high) = padded_range(values.chain(panel.references.iter().map(|reference| reference.y)));
    let y = Scale::new(low, high, area.bottom(), area.y);
    vertical_axis(svg, panel, area, &y);
    let x = horizontal_axis(svg, panel, area);
    references(svg, &panel.references, area, &y);
    if panel.series.is_empty() {
        let centre = (area.x + area.width / 2.0, area.y + area.height / 2.0);
        svg.text("f-soft", centre, TEXT, Anchor::Middle, "no evaluation yet");
    }
    // Bands first: no band may hide another series' line.
    let settings = matches!(panel.x, Horizontal::Settings { .. });
    let place = |point: &Point, value: f64| (x.at(point.x), y.at(value));
    for series in panel.series.iter().filter(|_| !settings) {
        band(svg, series, place);
    }
    for (index, series) in panel.series.iter().enumerate() {
        if settings {
            let side = index as f64 - (panel.series.len() as f64 - 1.0) / 2.0;
            let room = 0.8 * (x.at(1.0) - x.at(0.0)) / panel.series.len() as f64;
            columns(svg, series, |at| x.at(at) + side * room, &y, room);
        } else {
            let line: Vec<_> = series.points.iter().map(|point| place(point, point.mean)).collect();
            svg.polyline(&format!("f-line s-{}", colour(series.look)), &line, dash(series.look));
        }
    }
}

fn vertical_axis(svg: &mut Svg, panel: &Panel, area: Area, y: &Scale) {
    svg.text("f-text", (area.x, area.y - 34.0), 15.0, Anchor::Start, &panel.title);
    for tick in y.ticks(6) {
        let at = y.at(tick);
        svg.line("f-grid", (area.x, at), (area.right(), at));
        svg.text("f-soft", (area.x - 8.0, at + 4.0), SMALL, Anchor::End, &label(tick));
    }
    svg.line("f-axis", (area.x, area.y), (area.x, area.bottom()));
    svg.upright_text("f-soft", (area.x - 48.0, area.y + area.height / 2.0), SMALL, &panel.y_title);
}

/// Draws the horizontal axis and returns its scale.
fn horizontal_axis(svg: &mut Svg, panel: &Panel, area: Area) -> Scale {
    svg.line("f-axis", (area.x, area.bottom()), (area.right(), area.bottom()));
    let below = area.bottom() + 18.0;
    let (title, scale) = match &panel.x {
        Horizontal::Steps { title, switch } => {
            let places = || panel.series.iter().flat_map(|series| series.points.iter().map(|point| point.x));
            let high = places().fold(switch.unwrap_or(1.0), f64::max);
            // A panel without a point still has an axis.
            let (low, high) = (places().fold(0.0, f64::min), if high > 0.0 { high } else { 1.0 });
            let scale = Scale::new(low, high, area.x, area.right());
            for tick in scale.ticks(5) {
                let at = scale.at(tick);
                svg.line("f-axis", (at, area.bottom()), (at, area.bottom() + 4.0));
                svg.text("f-soft", (at, below), SMALL, Anchor::Middle, &label(tick));
            }
            if let Some(switch) = switch {
                phases(svg, area, scale.at(*switch));
            }
            (title, scale)
        }
        Horizontal::Settings { title, names } => {
            let scale = Scale::new(-0.5, names.len().max(1) as f64 - 0.5, area.x, area.right());
            for (index, name) in names.iter().enumerate() {
                svg.text("f-soft", (scale.at(index as f64), below), SMALL, Anchor::Middle, name);
            }
            (title, scale)
        }
    };
    svg.text("f-soft", (area.x + area.width / 2.0, below + 20.0), SMALL, Anchor::Middle, title);
    scale
}

/// The switch from Safe to Full: a line through the panel, both phases named above it.
fn phases(svg: &mut Svg, area: Area, switch: f64) {
    svg.line("f-mark", (switch, area.y - 18.0), (switch, area.bottom()));
    for (name, from, to) in [("Safe", area.x, switch), ("Full", switch, area.right())] {
        // A phase too short for its name goes without.
        if to - from > text_width(name, SMALL) + 8.0 {
            svg.text("f-text", ((from + to) / 2.0, area.y - 8.0), SMALL, Anchor::Middle, name);
        }
    }
}

/// Reference lines; their names stand right of the panel, pushed apart where they would touch.
fn references(svg: &mut Svg, list: &[Reference], area: Area, y: &Scale) {
    let mut sorted: Vec<&Reference> = list.iter().collect();
    sorted.sort_by(|a, b| a.y.total_cmp(&b.y));
    let mut lowest_free = f64::INFINITY;
    for reference in sorted {
        let at = y.at(reference.y);
        svg.line("f-ref", (area.x, at), (area.right(), at));
        let place = (at + 4.0).min(lowest_free);
        let text = format!("{} {}", reference.name, label(reference.y));
        svg.text("f-soft", (area.right() + 6.0, place), 10.5, Anchor::Start, &text);
        lowest_free = place - 13.0;
    }
}

fn band(svg: &mut Svg, series: &Series, place: impl Fn(&Point, f64) -> (f64, f64)) {
    let upper = series.points.iter().map(|point| place(point, point.high));
    let lower = series.points.iter().rev().map(|point| place(point, point.low));
    let outline: Vec<_> = upper.chain(lower).collect();
    svg.polygon(&format!("f-band b-{}", colour(series.look)), &outline);
}

/// A series over settings: every seed as a dot, the mean as a bar with its interval.
fn columns(svg: &mut Svg, series: &Series, place: impl Fn(f64) -> f64, y: &Scale, room: f64) {
    let class = format!("f-line s-{}", colour(series.look));
    for point in &series.points {
        let (x, mean) = (place(point.x), y.at(point.mean));
        svg.line(&class, (x, y.at(point.low)), (x, y.at(point.high)));
        svg.line(&class, (x - 0.36 * room, mean), (x + 0.36 * room, mean));
        let here: Vec<f64> = series.seeds.iter().filter(|seed| seed.0 == point.x).map(|seed| seed.1).collect();
        // Side by side in the order of seeds, so that equal values do not hide each other.
        let gap = (0.8 * room / here.len().max(1) as f64).min(9.0);
        for (index, value) in here.iter().enumerate() {
            let offset = (index as f64 - (here.len() as f64 - 1.0) / 2.0) * gap;
            marker(svg, "f-dot", series.look, (x + offset, y.at(*value)), 3.2);
        }
    }
}

/// A dot whose shape tells its series: circle, diamond, square in turn.
fn marker(svg: &mut Svg, class: &str, look: usize, (x, y): (f64, f64), radius: f64) {
    let class = format!("{class} b-{}", colour(look));
    let class = class.trim_start();
    match look % 3 {
        0 => svg.rect(class, (x - radius, y - radius), (2.0 * radius, 2.0 * radius), 0.0),
        1 => {
            let r = 1.3 * radius;
            svg.polygon(class, &[(x, y - r), (x + r, y), (x, y + r), (x - r, y)]);
        }
        _ => svg.circle(class, (x, y), radius),
    }
}

fn colour(look: usize) -> &'static str {
    SERIES[look % SERIES.len()]
}

fn dash(look: usize) -> &'static str {
    DASHES[look % DASHES.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_near_references_do_not_touch() {
        let at = |y: f64| Reference { y, name: "r".into() };
        let mut svg = Svg::new();
        let area = Area { x: 0.0, y: 0.0, width: 100.0, height: 100.0 };
        references(&mut svg, &[at(50.0), at(51.0), at(49.0)], area, &Scale::new(0.0, 100.0, 100.0, 0.0));
        let drawing = svg.finish((1.0, 1.0), "", "", true);
        let mut places: Vec<f64> = drawing
            .lines()
            .filter_map(|line| line.strip_prefix("<text")?.split("y=\"").nth(1)?.split('"').next()?.parse().ok())
            .collect();
        places.sort_by(f64::total_cmp);
        assert_eq!(places.len(), 3);
        assert!(places.windows(2).all(|pair| pair[1] - pair[0] >= 12.5), "{places:?}");
    }
}
