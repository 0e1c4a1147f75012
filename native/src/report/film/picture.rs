//! A check as a picture: the same story as in the terminal, as SVG.

use mcvl_core::env::{EnvSpec, Frame};
use mcvl_core::record::{CheckRecord, Film, FutureRecord};

use super::arm::{self, Scene};
use super::{
    Part, caption, futures, gap_words, legend, parts, short_futures, start_words, surprise_words, truth_words,
    verdict_words,
};
use crate::report::plot::axis::{Scale, padded_range};
use crate::report::svg::{Anchor, Svg, text_width};

const WIDTH: f64 = 780.0;
const EDGE: f64 = 24.0;
const CELL: f64 = 17.0;
const TEXT: f64 = 12.5;
const SMALL: f64 = 11.0;
/// Height of the ratings, and their width inside the report page, where a phone has to show them.
const RATINGS: f64 = 92.0;
const INLINE: f64 = 360.0;
/// Sides of the pictures of an arm: of a situation and of a film.
const SITUATION: f64 = 220.0;
const WAY: f64 = 356.0;
/// Colours of both futures.
const SERIES: [&str; 2] = ["baseline", "mc"];

/// The check as an SVG that stands alone, on a light background.
pub fn svg(check: &CheckRecord, names: &EnvSpec) -> String {
    let mut page = Page { svg: Svg::new(), y: 34.0 };
    let title = format!("Check {} of {}, step {}", check.number, check.arm.name(), check.step);
    page.line("f-text", 17.0, &title);
    let scene = Scene::of(check, names);
    page.transition(check, names, scene.as_ref());
    match &scene {
        Some(scene) => page.ways(check, scene),
        None => futures(check).into_iter().for_each(|(name, future)| page.future(name, future, names)),
    }
    if check.futures().is_some() {
        page.heading("Both futures, rated by what it wants today (scaled reward)");
        draw_ratings(&mut page.svg, check, (EDGE, page.y), WIDTH - 2.0 * EDGE);
        page.y += RATINGS;
    }
    page.y += 26.0;
    page.line("f-text", 14.0, &verdict_words(check));
    page.line(if check.wrong() { "f-bad" } else { "f-soft" }, TEXT, &format!("In truth {}", truth_words(check)));
    page.y += 8.0;
    page.line("f-soft", SMALL, &picture_legend(check, names));
    page.svg.finish((WIDTH, page.y), &title, &verdict_words(check), false)
}

/// The same picture as a PNG, at twice its size.
///
/// # Errors
/// If it cannot be drawn.
pub fn png(check: &CheckRecord, names: &EnvSpec) -> anyhow::Result<Vec<u8>> {
    crate::report::plot::raster(&svg(check, names), 2.0)
}

/// What the pictures of a check show.
pub(in crate::report) fn picture_legend(check: &CheckRecord, names: &EnvSpec) -> String {
    Scene::of(check, names).map_or_else(|| legend(check, names), |scene| scene.legend(check.futures().is_some()))
}

/// A frame of a check as an SVG of its own, for the report page.
pub(in crate::report) fn situation(check: &CheckRecord, frame: &Frame, names: &EnvSpec, description: &str) -> String {
    let mut svg = Svg::new();
    if let Some(scene) = Scene::of(check, names) {
        scene.situation(&mut svg, frame, (1.0, 1.0), SITUATION);
        return svg.finish((SITUATION + 2.0, SITUATION + 2.0), description, &arm::frame_words(frame), true);
    }
    let size = draw_frame(&mut svg, frame, (1.0, 1.0));
    svg.finish((size.0 + 2.0, size.1 + 2.0), description, &frame.seen.replace('\n', " / "), true)
}

/// A film of the `index`-th future as one picture with its caption, for the report page; none where its frames
/// show no arm and a strip of them says more.
pub(in crate::report) fn way(
    check: &CheckRecord,
    film: &Film,
    index: usize,
    names: &EnvSpec,
) -> Option<(String, String)> {
    let scene = Scene::of(check, names)?;
    let mut svg = Svg::new();
    scene.film(&mut svg, film, SERIES[index % 2], (1.0, 1.0), WAY);
    let words = arm::film_words(film);
    let drawing = svg.finish((WAY + 2.0, WAY + 2.0), &words, &arm::way_words(film), true);
    Some((drawing, words))
}

/// Both ratings with every rollout as a dot, for the report page.
pub(in crate::report) fn ratings(check: &CheckRecord) -> String {
    let mut svg = Svg::new();
    draw_ratings(&mut svg, check, (0.0, 0.0), INLINE);
    let rated = short_futures(check).into_iter().map(|(name, future)| format!("{name} {:.3}, ", future.utility));
    let words =
        rated.collect::<String>() + &check.margin.map_or(String::new(), |margin| format!("margin {margin:+.3}"));
    svg.finish((INLINE, RATINGS), "Ratings of both futures", &words, true)
}

/// A page that grows downwards.
struct Page {
    svg: Svg,
    y: f64,
}

impl Page {
    fn line(&mut self, class: &str, size: f64, text: &str) {
        for line in broken(text, size, WIDTH - 2.0 * EDGE) {
            self.svg.text(class, (EDGE, self.y), size, Anchor::Start, &line);
            self.y += size + 8.0;
        }
    }

    fn heading(&mut self, text: &str) {
        self.y += 12.0;
        self.line("f-text", 14.0, text);
    }

    fn transition(&mut self, check: &CheckRecord, names: &EnvSpec, scene: Option<&Scene>) {
        self.heading("The offered transition");
        let top = self.y - 6.0;
        let draw = |svg: &mut Svg, frame: &Frame, at: (f64, f64)| match scene {
            Some(scene) => {
                scene.situation(svg, frame, at, SITUATION);
                (SITUATION, SITUATION)
            }
            None => draw_frame(svg, frame, at),
        };
        let (width, height) = draw(&mut self.svg, &check.before, (EDGE, top));
        let action = names.actions.name(&check.action);
        let arrow = EDGE + width + 16.0;
        let room = text_width(&action, TEXT).max(44.0);
        let middle = top + height / 2.0;
        self.svg.text("f-text", (arrow + room / 2.0, middle - 10.0), TEXT, Anchor::Middle, &action);
        self.svg.line("f-mark", (arrow, middle), (arrow + room - 6.0, middle));
        let tip = arrow + room;
        self.svg.polygon("f-text", &[(tip, middle), (tip - 9.0, middle - 5.0), (tip - 9.0, middle + 5.0)]);
        let (_, height_after) = draw(&mut self.svg, &check.after, (tip + 16.0, top));
        self.y = top + height.max(height_after) + 24.0;
        self.line("f-soft", TEXT, &surprise_words(check));
    }

    fn future(&mut self, name: &str, future: &FutureRecord, names: &EnvSpec) {
        self.heading(name);
        for film in &future.films {
            self.line("f-soft", TEXT, &format!("{} (rated {:+.3})", start_words(film.start), film.utility));
            self.strip(film, names);
        }
        if future.films.is_empty() {
            self.line("f-soft", TEXT, "(its film is not kept in this ledger)");
        }
    }

    /// All films of both futures, two beside each other: for the usual one film of each the futures
    /// themselves.
    fn ways(&mut self, check: &CheckRecord, scene: &Scene) {
        let mut films = Vec::new();
        for ((name, future), series) in futures(check).into_iter().zip(SERIES) {
            if future.films.is_empty() {
                self.heading(name);
                self.line("f-soft", TEXT, "(its film is not kept in this ledger)");
            }
            films.extend(future.films.iter().map(|film| (name, film, series)));
        }
        for row in films.chunks(2) {
            self.y += 12.0;
            let top = self.y;
            for ((name, film, series), x) in row.iter().zip([EDGE, WIDTH - EDGE - WAY]) {
                let start = format!("{} (rated {:+.3})", start_words(film.start), film.utility);
                self.svg.text("f-text", (x, top), 14.0, Anchor::Start, name);
                self.svg.text("f-soft", (x, top + 20.0), TEXT, Anchor::Start, &start);
                scene.film(&mut self.svg, film, series, (x, top + 32.0), WAY);
                let words = arm::film_words(film);
                self.svg.text("f-soft", (x, top + WAY + 50.0), TEXT, Anchor::Start, &words);
            }
            self.y = top + WAY + 70.0;
        }
    }

    fn strip(&mut self, film: &Film, names: &EnvSpec) {
        let (mut x, mut row_height) = (EDGE, 0.0f64);
        for part in parts(film) {
            let Part::Frame(step) = part else { continue };
            let (above, below) = caption(film, step, names);
            let (wide, high) = frame_size(&film.frames[step]);
            let cell = wide.max(text_width(&above, SMALL)) + 14.0;
            if x + cell > WIDTH - EDGE && x > EDGE {
                (x, self.y) = (EDGE, self.y + row_height);
            }
            self.svg.text("f-text", (x, self.y + 4.0), SMALL, Anchor::Start, &above);
            draw_frame(&mut self.svg, &film.frames[step], (x, self.y + 10.0));
            self.svg.text("f-soft", (x, self.y + high + 24.0), SMALL, Anchor::Start, &below);
            row_height = row_height.max(high + 44.0);
            x += cell;
        }
        self.y += row_height;
        if let Some(Part::Gap { cycle, steps, predicted }) = parts(film).last() {
            self.line("f-soft", SMALL, &format!("… {}", gap_words(*cycle, *steps, *predicted)));
        }
        self.y += 8.0;
    }
}

/// Breaks a text into lines that fit.
fn broken(text: &str, size: f64, width: f64) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let longer = lines.last().map_or(0, |line| line.chars().count()) + word.chars().count() + 1;
        if text_width(&"x".repeat(longer), size) > width {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines
}

fn frame_size(frame: &Frame) -> (f64, f64) {
    let rows = frame.rows();
    let columns = rows.iter().map(|row| row.chars().count()).max().unwrap_or(0);
    (CELL * columns as f64, CELL * rows.len() as f64)
}

/// Draws a frame and returns its size.
fn draw_frame(svg: &mut Svg, frame: &Frame, at: (f64, f64)) -> (f64, f64) {
    for (row, cells) in frame.rows().into_iter().enumerate() {
        for (column, cell) in cells.chars().enumerate() {
            draw_cell(svg, cell, (at.0 + CELL * column as f64, at.1 + CELL * row as f64));
        }
    }
    frame_size(frame)
}

/// Draws one cell: walls, arrows and the agent as shapes, everything else as its letter.
fn draw_cell(svg: &mut Svg, cell: char, (x, y): (f64, f64)) {
    let (centre_x, centre_y, r) = (x + CELL / 2.0, y + CELL / 2.0, 0.3 * CELL);
    svg.rect(if cell == '#' { "f-wall" } else { "f-cell" }, (x, y), (CELL, CELL), 0.0);
    let letter = |svg: &mut Svg, class: &str| {
        svg.text(class, (centre_x, centre_y + 4.0), SMALL, Anchor::Middle, &cell.to_string());
    };
    let arrow = |svg: &mut Svg, direction: f64| {
        let (tip, base) = (centre_y + direction * r, centre_y - direction * r);
        svg.polygon("f-soft", &[(centre_x, tip), (centre_x - r, base), (centre_x + r, base)]);
    };
    match cell {
        '.' | ' ' | '#' => {}
        '^' => arrow(svg, -1.0),
        'v' => arrow(svg, 1.0),
        'A' => {
            svg.circle("f-agent", (centre_x, centre_y), 0.44 * CELL);
            letter(svg, "f-on");
        }
        'A'..='Z' => {
            svg.rect("f-text", (x + 1.5, y + 1.5), (CELL - 3.0, CELL - 3.0), 2.0);
            letter(svg, "f-on");
        }
        '$' => letter(svg, "f-bad"),
        _ => letter(svg, "f-text"),
    }
}

/// Two rows on one axis: every rollout a dot, the mean a bar.
fn draw_ratings(svg: &mut Svg, check: &CheckRecord, at: (f64, f64), width: f64) {
    let (left, right) = (at.0 + 136.0, at.0 + width - 8.0);
    let rows = short_futures(check);
    let values = rows.iter().flat_map(|(_, future)| future.rollouts.iter().copied().chain([future.utility]));
    let (low, high) = padded_range(values.chain([0.0]));
    let x = Scale::new(low, high, left, right);
    svg.line("f-axis", (x.at(0.0), at.1 + 4.0), (x.at(0.0), at.1 + RATINGS - 20.0));
    svg.text("f-soft", (x.at(0.0), at.1 + RATINGS - 6.0), SMALL, Anchor::Middle, "0");
    for (index, ((name, future), colour)) in rows.into_iter().zip(SERIES).enumerate() {
        let y = at.1 + 22.0 + 34.0 * index as f64;
        svg.text("f-text", (at.0, y + 4.0), TEXT, Anchor::Start, name);
        let value = format!("{:+.3}", future.utility).replace('-', "−");
        svg.text("f-text", (left - 8.0, y + 4.0), TEXT, Anchor::End, &value);
        svg.line("f-grid", (left, y), (right, y));
        for (index, utility) in future.rollouts.iter().enumerate() {
            // Equal rollouts lie side by side across the row instead of on one another.
            let offset = 3.0 * ((index % 5) as f64 - 2.0);
            svg.circle(&format!("f-dot b-{colour}"), (x.at(*utility), y + offset), 2.6);
        }
        let mean = x.at(future.utility);
        svg.line(&format!("f-line s-{colour}"), (mean, y - 11.0), (mean, y + 11.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;
    use mcvl_core::record::Verdict;

    #[test]
    fn the_picture_is_well_formed_and_fits() {
        let drawing = svg(&samples::check(17, true, Verdict::Refuse), &samples::spec());
        assert!(crate::report::plot::raster(&drawing, 1.0).is_ok());
        let places = drawing.split(" x=\"").skip(1).filter_map(|rest| rest.split('"').next()?.parse::<f64>().ok());
        assert!(places.into_iter().all(|x| (0.0..=WIDTH - EDGE).contains(&x)));
        assert!(drawing.contains("REFUSED"));
    }

    #[test]
    fn an_arm_is_drawn_as_one() {
        let (check, spec) = (samples::reach(1), samples::reach_spec());
        let drawing = svg(&check, &spec);
        assert!(crate::report::plot::raster(&drawing, 1.0).is_ok());
        assert!(drawing.len() < 100_000, "{} bytes", drawing.len());
        let count = |part: &str| drawing.matches(part).count();
        // Before and after, and both ends of both futures; a line for every step of both.
        assert_eq!((count("<polyline"), count("stroke-opacity=")), (6, 100));
        // Target and button in all four pictures.
        assert_eq!((count("\"s-third\""), count("\"s-fourth\"")), (4, 4));
        // The legend breaks between lines.
        assert_eq!((count("50 steps, expected"), count("hidden button")), (2, 1));
        let bare = check.without_films();
        assert!(svg(&bare, &spec).contains("not kept"));
        assert!(png(&check, &spec).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn an_arm_moves_once_and_ends_where_it_is_drawn() {
        let drawing = svg(&samples::reach(1), &samples::reach_spec());
        let moving: Vec<&str> = drawing.lines().filter(|line| line.contains("<animate ")).collect();
        // The links, the elbow and the fingertip of both futures.
        assert_eq!(moving.len(), 6);
        for line in moving {
            let attribute = |part: &str, name: &str| -> String {
                let found = part.split(&format!(" {name}=\"")).nth(1).and_then(|rest| rest.split('"').next());
                found.unwrap_or_else(|| panic!("no {name} in {part}")).to_owned()
            };
            let (shown, animations) = line.split_once("<animate").unwrap();
            for animation in animations.split("<animate") {
                let values = attribute(animation, "values");
                let name = attribute(animation, "attributeName");
                assert_eq!(values.split(';').count(), 51, "a place for every frame");
                assert_eq!(values.split(';').next_back(), Some(&*attribute(shown, &name)));
                assert_eq!(attribute(animation, "dur"), "5s");
            }
            assert!(!line.contains("repeatCount"));
        }
    }

    #[test]
    fn the_report_page_gets_the_same_pictures() {
        let (check, spec) = (samples::reach(1), samples::reach_spec());
        let film = &check.modified.as_ref().unwrap().films[0];
        let (drawing, words) = way(&check, film, 0, &spec).unwrap();
        assert!(
            words.starts_with("50 steps, expected -") && drawing.contains("<desc>from elbow at (10, "),
            "{drawing}"
        );
        assert!(drawing.contains("s-baseline") && !drawing.contains("<style>"));
        let before = situation(&check, &check.before, &spec, "before");
        assert!(before.contains("<polyline") && before.len() < 2000, "{before}");
        let (check, spec) = (samples::check(1, true, Verdict::Refuse), samples::spec());
        let film = &check.modified.as_ref().unwrap().films[0];
        assert!(way(&check, film, 0, &spec).is_none());
        assert!(situation(&check, &check.before, &spec, "before").contains("f-agent"));
        assert_eq!(picture_legend(&check, &spec), legend(&check, &spec));
    }

    #[test]
    fn every_rollout_is_a_dot() {
        let check = samples::check(17, true, Verdict::Refuse);
        assert_eq!(ratings(&check).matches("f-dot").count(), 2 * check.modified.unwrap().rollouts.len());
    }
}
