//! One writer of SVG for figures and films: elements, numbers that always read the same, one palette.
//!
//! Drawings carry class names, not colours. A drawing that stands alone brings the light palette along
//! as its style sheet; inside the report page the same classes read the page's variables, so that one
//! drawing serves both schemes.

use std::fmt::Write as _;

/// A colour with its value in the light and in the dark scheme. Series follow Okabe and Ito's palette,
/// which stays distinguishable with any colour vision; dark values are its lighter neighbours.
const COLOURS: &[(&str, &str, &str)] = &[
    ("paper", "#ffffff", "#1b1e23"),
    ("panel", "#f6f7f9", "#23272e"),
    ("ink", "#1c2430", "#e8eaee"),
    ("soft", "#5a6472", "#a6afbb"),
    ("line", "#d9dde3", "#3a414b"),
    ("safe", "#4d4d4d", "#c4c9d0"),
    ("baseline", "#b84700", "#f08a4b"),
    ("mc", "#0067a3", "#62b5e8"),
    ("third", "#00795a", "#3cc39b"),
    ("fourth", "#9c4f80", "#dd94c0"),
    ("fifth", "#8a6d00", "#e3c02f"),
    ("sixth", "#6b4fa0", "#b9a2ea"),
    ("seventh", "#2f7d32", "#7fcf82"),
    ("good", "#00694e", "#4fcfa8"),
    ("bad", "#a83c00", "#ff9a5c"),
];

/// The style of every class, in terms of the palette.
const STYLE: &str = "\
.f-back{fill:var(--paper)}\
.f-text{fill:var(--ink)}.f-soft{fill:var(--soft)}\
.f-grid{stroke:var(--line);stroke-width:1}.f-axis{stroke:var(--soft);stroke-width:1}\
.f-mark{stroke:var(--ink);stroke-width:1.5}\
.f-ref{stroke:var(--soft);stroke-width:1.2;stroke-dasharray:1 4;stroke-linecap:round}\
.f-line{fill:none;stroke-width:2.4;stroke-linejoin:round;stroke-linecap:butt}\
.f-band{fill-opacity:.18}\
.f-dot{fill-opacity:.55}\
.f-cell{fill:var(--panel);stroke:var(--line);stroke-width:1}\
.f-wall{fill:var(--soft);stroke:var(--line);stroke-width:1}\
.f-agent{fill:var(--mc)}.f-on{fill:var(--paper)}\
.f-good{fill:var(--good)}.f-bad{fill:var(--bad)}";

/// Names of the colours that tell series apart, in the order in which they are given out.
pub(super) const SERIES: &[&str] = &["safe", "baseline", "mc", "third", "fourth", "fifth", "sixth", "seventh"];

/// The palette as CSS custom properties: of the dark scheme or of the light one.
pub(super) fn variables(dark: bool) -> String {
    COLOURS.iter().fold(String::new(), |mut css, (name, light, dark_value)| {
        let _ = write!(css, "--{name}:{};", if dark { dark_value } else { light });
        css
    })
}

/// The style sheet of drawings, reading the variables of [`variables`].
pub(super) fn style() -> String {
    let mut css = STYLE.to_owned();
    for name in SERIES {
        let _ = write!(css, ".s-{name}{{stroke:var(--{name})}}.b-{name}{{fill:var(--{name})}}");
    }
    css
}

/// The style sheet with the light palette put in, for drawings that stand alone.
fn standalone_style() -> String {
    let mut css = style();
    for (name, light, _) in COLOURS {
        css = css.replace(&format!("var(--{name})"), light);
    }
    css
}

/// Text as it may stand between tags and in quoted attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // XML has no way to write other control characters.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// A number with at most two decimals: the same number, the same text.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Width of a text in the figure's font, estimated from above: what is placed by it never overlaps.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    0.62 * size * text.chars().count() as f64
}

/// Where a text stands relative to its point.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A drawing under construction.
pub(super) struct Svg {
    body: String,
}

impl Svg {
    pub(super) fn new() -> Self {
        Self { body: String::new() }
    }

    /// An element without content; attribute values are escaped.
    pub(super) fn element(&mut self, tag: &str, attributes: &[(&str, &str)]) {
        self.open(tag, attributes);
        self.body.push_str("/>\n");
    }

    /// An element of which some attributes move, once, through lists of values. What plays no animations shows
    /// `attributes`.
    pub(super) fn moving(
        &mut self,
        tag: &str,
        attributes: &[(&str, &str)],
        seconds: f64,
        through: &[(&str, Vec<String>)],
    ) {
        self.open(tag, attributes);
        self.body.push('>');
        let duration = format!("{}s", number(seconds));
        for (name, values) in through {
            let values = values.join(";");
            self.open("animate", &[("attributeName", name), ("dur", &duration), ("values", &values)]);
            self.body.push_str("/>");
        }
        let _ = writeln!(self.body, "</{tag}>");
    }

    fn open(&mut self, tag: &str, attributes: &[(&str, &str)]) {
        let _ = write!(self.body, "<{tag}");
        for (name, value) in attributes {
            let _ = write!(self.body, " {name}=\"{}\"", escape(value));
        }
    }

    pub(super) fn line(&mut self, class: &str, from: (f64, f64), to: (f64, f64)) {
        let (x1, y1, x2, y2) = (number(from.0), number(from.1), number(to.0), number(to.1));
        self.element("line", &[("class", class), ("x1", &x1), ("y1", &y1), ("x2", &x2), ("y2", &y2)]);
    }

    pub(super) fn rect(&mut self, class: &str, at: (f64, f64), size: (f64, f64), radius: f64) {
        let (x, y, width, height) = (number(at.0), number(at.1), number(size.0), number(size.1));
        let radius = number(radius);
        let place = [("x", x.as_str()), ("y", &y), ("width", &width), ("height", &height), ("rx", &radius)];
        self.element("rect", &[&[("class", class)], place.as_slice()].concat());
    }

    pub(super) fn circle(&mut self, class: &str, centre: (f64, f64), radius: f64) {
        let (x, y, r) = (number(centre.0), number(centre.1), number(radius));
        self.element("circle", &[("class", class), ("cx", &x), ("cy", &y), ("r", &r)]);
    }

    /// A line through points; `dash` is empty for a solid one.
    pub(super) fn polyline(&mut self, class: &str, points: &[(f64, f64)], dash: &str) {
        let points = point_list(points);
        let mut attributes = vec![("class", class), ("points", points.as_str())];
        if !dash.is_empty() {
            attributes.push(("stroke-dasharray", dash));
        }
        self.element("polyline", &attributes);
    }

    pub(super) fn polygon(&mut self, class: &str, points: &[(f64, f64)]) {
        self.element("polygon", &[("class", class), ("points", &point_list(points))]);
    }

    pub(super) fn text(&mut self, class: &str, at: (f64, f64), size: f64, anchor: Anchor, text: &str) {
        self.place_text(class, at, size, anchor, text, "");
    }

    /// A text that reads upwards.
    pub(super) fn upright_text(&mut self, class: &str, at: (f64, f64), size: f64, text: &str) {
        let turn = format!(" transform=\"rotate(-90 {} {})\"", number(at.0), number(at.1));
        self.place_text(class, at, size, Anchor::Middle, text, &turn);
    }

    fn place_text(&mut self, class: &str, at: (f64, f64), size: f64, anchor: Anchor, text: &str, extra: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let (x, y, size) = (number(at.0), number(at.1), number(size));
        let _ = writeln!(
            self.body,
            "<text class=\"{class}\" x=\"{x}\" y=\"{y}\" font-size=\"{size}\" text-anchor=\"{anchor}\"{extra}>{}</text>",
            escape(text)
        );
    }

    /// The whole drawing. `inline` leaves out what the page brings: style, background and font.
    pub(super) fn finish(self, size: (f64, f64), title: &str, description: &str, inline: bool) -> String {
        let (width, height) = (number(size.0), number(size.1));
        let (own, style) = if inline {
            (String::new(), String::new())
        } else {
            let own =
                " xmlns=\"http://www.w3.org/2000/svg\" font-family=\"'DejaVu Sans',Verdana,sans-serif\"".to_owned();
            let back = format!("<rect class=\"f-back\" width=\"{width}\" height=\"{height}\"/>\n");
            (own, format!("<style>{}</style>\n{back}", standalone_style()))
        };
        format!(
            "<svg{own} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" role=\"img\">\n<title>{}</title>\n<desc>{}</desc>\n{style}{}</svg>\n",
            escape(title),
            escape(description),
            self.body
        )
    }
}

fn point_list(points: &[(f64, f64)]) -> String {
    points.iter().map(|(x, y)| format!("{},{}", number(*x), number(*y))).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_have_one_form() {
        let forms: Vec<String> = [1.0, 0.125, -0.001, 1e3, -2.5].map(number).into();
        assert_eq!(forms, ["1", "0.12", "0", "1000", "-2.5"]);
    }

    #[test]
    fn nothing_breaks_out_of_text_or_attribute() {
        assert_eq!(escape("<a b='\"&\u{1}>"), "&lt;a b=&#39;&quot;&amp;\u{fffd}&gt;");
    }

    #[test]
    fn a_drawing_alone_leaves_no_variable_open() {
        let drawing = Svg::new().finish((10.0, 10.0), "t", "d", false);
        assert!(!drawing.contains("var("), "{drawing}");
        assert!(!Svg::new().finish((10.0, 10.0), "t", "d", true).contains("<style>"));
    }
}
