//! An arm in the plane, read back from the characters of its frames and drawn as what they stand for.
//!
//! Ledgers and tapes keep frames, not poses: what can be drawn is known to about half a cell, 1 cm wide and
//! 2 cm high. The lengths of the links and the way of the fingertip from step to step narrow that down.

use std::f64::consts::PI;

use mcvl_core::env::reacher::button::REACH;
use mcvl_core::env::reacher::physics::{FOREARM, UPPER_ARM};
use mcvl_core::env::{ActionSpec, EnvSpec, Frame};
use mcvl_core::record::{CheckRecord, Film};

use super::signed;
use crate::report::svg::{Anchor, Svg, number};

/// Metres per column and per row of a frame.
const CELL: [f64; 2] = [0.01, 0.02];
/// Half the side of the square that is drawn: the reach and a little air.
const HALF: f64 = REACH + 0.02;
/// Steps between two numbers along the way of the fingertip.
const NUMBERED: usize = 10;
/// Numbers nearer to one another than this, in pixels, could not be read.
const APART: f64 = 24.0;
const SMALL: f64 = 11.0;

/// A place in metres; the shoulder is the origin.
type Place = [f64; 2];

/// Whether the frames of a world are pictures of an arm in the plane.
pub(super) fn is_arm(names: &EnvSpec) -> bool {
    let means = |mark: char, meaning: &str| names.legend.contains(&(mark, meaning));
    matches!(names.actions, ActionSpec::Continuous { .. })
        && means('O', "shoulder")
        && means('o', "elbow")
        && means('X', "fingertip")
}

/// Pace of a moving film, seconds: a fifth of the world's own.
const SECONDS_PER_STEP: f64 = 0.1;

/// What a frame shows.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    elbow: Place,
    tip: Place,
    target: Place,
    /// Middle of the fingertip's cell, which `tip` need not be.
    cell: Place,
}

impl Pose {
    /// Reads a frame; none where it shows no arm.
    fn read(frame: &Frame) -> Option<Self> {
        let cells = cells(&frame.seen);
        let find = |mark: char| cells.iter().find(|(_, cell)| *cell == mark).map(|(place, _)| *place);
        // A cell holds one character. Core draws the links first, then shoulder, elbow, target and fingertip, so
        // that the target can hide the elbow, and the fingertip the target. A fingertip straight above the
        // shoulder can lie beyond the last row: then the forearm's end is the nearest to it that is seen.
        let target = find('T');
        let elbow = find('o').or(target)?;
        let forearm = || cells.iter().filter(|(_, cell)| *cell == '=').map(|(place, _)| *place);
        let far = || forearm().max_by(|a, b| distance(*a, elbow).total_cmp(&distance(*b, elbow)));
        let cell = find('X').or_else(far)?;
        let (elbow, tip) = fitted(elbow, cell);
        Some(Self { elbow, tip, target: target.unwrap_or(cell), cell })
    }

    /// The pose in words, in centimetres.
    fn words(&self) -> String {
        let at = |[x, y]: Place| format!("({:.0}, {:.0}) cm", 100.0 * x, 100.0 * y);
        format!("elbow at {}, fingertip at {}, target at {}", at(self.elbow), at(self.tip), at(self.target))
    }
}

/// The cells of a picture with their places; the shoulder is in the middle.
fn cells(picture: &str) -> Vec<(Place, char)> {
    let rows: Vec<&str> = picture.split('\n').collect();
    let middle = rows.len() as f64 / 2.0 - 0.5;
    let mut cells = Vec::new();
    for (row, text) in rows.iter().enumerate() {
        let centre = text.chars().count() as f64 / 2.0 - 0.5;
        let place = |column: usize| [CELL[0] * (column as f64 - centre), CELL[1] * (middle - row as f64)];
        cells.extend(text.chars().enumerate().map(|(column, cell)| (place(column), cell)));
    }
    cells
}

fn distance(a: Place, b: Place) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// How far a place is from the middle of a cell, squared, in cells.
fn off(place: Place, cell: Place) -> f64 {
    ((place[0] - cell[0]) / CELL[0]).powi(2) + ((place[1] - cell[1]) / CELL[1]).powi(2)
}

/// Elbow and fingertip of the arm that agrees best with their cells. Its links have their true lengths, so
/// the arm does not grow and shrink from frame to frame.
fn fitted(elbow: Place, tip: Place) -> (Place, Place) {
    let from = |[x, y]: Place, length: f64, angle: f64| [x + length * angle.cos(), y + length * angle.sin()];
    // Half a cell at both ends of a link turns it by no more than this.
    let around = |angle: f64| (-20..=20).map(move |part| angle + 0.01 * f64::from(part));
    let upper = elbow[1].atan2(elbow[0]);
    let fore = (tip[1] - elbow[1]).atan2(tip[0] - elbow[0]);
    let arms = around(upper).flat_map(|first| {
        let joint = from([0.0, 0.0], UPPER_ARM, first);
        around(fore).map(move |second| (joint, from(joint, FOREARM, second)))
    });
    let error = |(joint, end): &(Place, Place)| off(*joint, elbow) + off(*end, tip);
    arms.min_by(|a, b| error(a).total_cmp(&error(b))).unwrap_or((elbow, tip))
}

/// The smoothest way of the fingertip that stays in the cells it was seen in. The middles of the cells would
/// make a staircase of it, which the arm never went.
fn way(poses: &[Pose]) -> Vec<Place> {
    let mut way: Vec<Place> = poses.iter().map(|pose| pose.tip).collect();
    for _ in 0..100 {
        for step in 1..way.len().saturating_sub(1) {
            for axis in 0..2 {
                let middle = (way[step - 1][axis] + way[step + 1][axis]) / 2.0;
                let (cell, half) = (poses[step].cell[axis], CELL[axis] / 2.0);
                way[step][axis] = middle.clamp(cell - half, cell + half);
            }
        }
    }
    way
}

/// The button as the truth of all frames together shows it: a single one hides parts of it under the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Disc {
    centre: Place,
    radius: f64,
}

impl Disc {
    fn read<'a>(frames: impl Iterator<Item = &'a Frame> + Clone) -> Option<Self> {
        let truths = frames.filter_map(|frame| frame.truth.as_deref());
        // The world is the same all along: a cell is the button's if any frame says so, and not if any shows
        // it empty. What the arm always hides counts as the button's inside its bounds.
        let (mut own, mut empty) = (Vec::new(), Vec::new());
        for (index, (place, cell)) in truths.flat_map(|truth| cells(truth).into_iter().enumerate()) {
            let known = match cell {
                '+' => &mut own,
                '.' => &mut empty,
                _ => continue,
            };
            if known.len() <= index {
                known.resize(index + 1, None);
            }
            known[index] = Some(place);
        }
        let places = || own.iter().flatten();
        places().next()?;
        let bound =
            |axis: usize, pick: fn(f64, f64) -> f64, from: f64| places().map(|place| place[axis]).fold(from, pick);
        let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
        let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
        let count = |from: f64, to: f64, size: f64| ((to - from) / size).round() as usize + 1;
        let all = count(low[0], high[0], CELL[0]) * count(low[1], high[1], CELL[1]);
        let inside = |place: &&Place| (0..2).all(|axis| (low[axis]..=high[axis]).contains(&place[axis]));
        let area = (all - empty.iter().flatten().filter(inside).count()) as f64 * CELL[0] * CELL[1];
        let centre = [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0);
        Some(Self { centre, radius: (area / PI).sqrt() })
    }
}

/// What stays the same in all pictures of a check.
pub(super) struct Scene {
    button: Option<Disc>,
}

impl Scene {
    /// The scene of a check; none where its frames show no arm.
    pub(super) fn of(check: &CheckRecord, names: &EnvSpec) -> Option<Self> {
        let arm = is_arm(names) && Pose::read(&check.before).is_some() && Pose::read(&check.after).is_some();
        arm.then(|| {
            let futures = check.modified.iter().chain(&check.unmodified);
            let films = futures.flat_map(|future| &future.films).flat_map(|film| &film.frames);
            Self { button: Disc::read(films.chain([&check.before, &check.after])) }
        })
    }

    /// What the pictures of the check show, in words.
    pub(super) fn legend(&self, forecast: bool) -> String {
        let mut words = String::from(
            "The arm from the shoulder in the middle, its fingertip a coloured dot; the ring is the target, the thin \
             circle as far as the arm reaches",
        );
        if self.button.is_some() {
            words += ", the dashed circle the hidden button, which the check does not see";
        }
        words += ".";
        if forecast {
            words += " A future is the way of its fingertip, fainter the longer ago, with the number of every tenth \
                      step where there is room; the faint arm is its start, the other its end.";
        }
        words + " Read from frames of 1 by 2 cm a cell."
    }

    /// Draws one situation into a square.
    pub(super) fn situation(&self, svg: &mut Svg, frame: &Frame, at: (f64, f64), side: f64) {
        let plane = Plane { at, side };
        let pose = Pose::read(frame);
        self.ground(svg, &plane);
        if let Some(pose) = pose {
            arm(svg, &plane, &pose, pose.tip, "mc", 1.0);
            target(svg, &plane, &pose);
        }
    }

    /// Draws a film into a square: the way of the fingertip, and the arm at its start and at its end.
    pub(super) fn film(&self, svg: &mut Svg, film: &Film, series: &str, at: (f64, f64), side: f64) {
        let plane = Plane { at, side };
        let poses: Vec<Pose> = film.frames.iter().filter_map(Pose::read).collect();
        self.ground(svg, &plane);
        let (Some(first), Some(last)) = (poses.first(), poses.last()) else { return };
        let way = way(&poses);
        arm(svg, &plane, first, way[0], series, 0.3);
        moving_arm(svg, &plane, &poses, &way, series);
        let points: Vec<(f64, f64)> = way.iter().map(|place| plane.point(*place)).collect();
        for (step, pair) in points.windows(2).enumerate() {
            let opacity = number(0.2 + 0.8 * (step + 1) as f64 / (points.len() - 1) as f64);
            let [x1, y1, x2, y2] = [pair[0].0, pair[0].1, pair[1].0, pair[1].1].map(number);
            let ends = [("x1", x1.as_str()), ("y1", &y1), ("x2", &x2), ("y2", &y2)];
            let class = format!("s-{series}");
            let look = [("class", class.as_str()), ("stroke-width", "2.2"), ("stroke-opacity", &opacity)];
            svg.element("line", &[look.as_slice(), ends.as_slice()].concat());
        }
        target(svg, &plane, last);
        // Start, end and target have their marks already.
        let taken = vec![points[0], points[points.len() - 1], plane.point(last.target)];
        numbers(svg, &points, taken, series);
    }

    /// What lies under the arm.
    fn ground(&self, svg: &mut Svg, plane: &Plane) {
        svg.rect("f-cell", plane.at, (plane.side, plane.side), 3.0);
        ring(svg, "f-grid", plane.point([0.0, 0.0]), plane.length(REACH), "1", "none");
        if let Some(button) = &self.button {
            ring(svg, "s-fourth", plane.point(button.centre), plane.length(button.radius), "1.5", "5 3");
        }
    }
}

/// A circle that is not filled. Its look is written on it: a style sheet would go into every figure there is.
fn ring(svg: &mut Svg, class: &str, centre: (f64, f64), radius: f64, width: &str, dash: &str) {
    let (x, y, r) = (number(centre.0), number(centre.1), number(radius));
    let look = [("class", class), ("fill", "none"), ("stroke-width", width), ("stroke-dasharray", dash)];
    svg.element("circle", &[look.as_slice(), &[("cx", &x), ("cy", &y), ("r", &r)]].concat());
}

/// The square of a picture.
struct Plane {
    at: (f64, f64),
    side: f64,
}

impl Plane {
    fn length(&self, metres: f64) -> f64 {
        metres * self.side / (2.0 * HALF)
    }

    fn point(&self, [x, y]: Place) -> (f64, f64) {
        (self.at.0 + self.length(x + HALF), self.at.1 + self.length(HALF - y))
    }
}

/// The arm at the end of a film. Where animations are played it first goes the whole way, once: five seconds at
/// most, so that nobody needs a button to stop it.
fn moving_arm(svg: &mut Svg, plane: &Plane, poses: &[Pose], way: &[Place], series: &str) {
    let (seconds, end) = (SECONDS_PER_STEP * (way.len() - 1) as f64, way.len() - 1);
    let joints: Vec<[(f64, f64); 2]> =
        poses.iter().zip(way).map(|(pose, tip)| [plane.point(pose.elbow), plane.point(*tip)]).collect();
    let shoulder = plane.point([0.0, 0.0]);
    let links = |[elbow, tip]: &[(f64, f64); 2]| {
        [shoulder, *elbow, *tip].map(|(x, y)| format!("{},{}", number(x), number(y))).join(" ")
    };
    let along = |joint: usize, axis: fn((f64, f64)) -> f64| -> Vec<String> {
        joints.iter().map(|both| number(axis(both[joint]))).collect()
    };
    let look = [("class", "s-safe"), ("fill", "none"), ("stroke-width", "7")];
    let ends = [("stroke-linejoin", "round"), ("stroke-linecap", "round"), ("points", &*links(&joints[end]))];
    let through = [("points", joints.iter().map(links).collect())];
    svg.moving("polyline", &[look.as_slice(), ends.as_slice()].concat(), seconds, &through);
    svg.circle("f-text", shoulder, 5.0);
    let tip_class = format!("b-{series}");
    for (joint, class, radius) in [(0, "f-on", "3"), (1, &*tip_class, "5")] {
        let (cx, cy) = (number(joints[end][joint].0), number(joints[end][joint].1));
        let look = [("class", class), ("cx", &*cx), ("cy", &*cy), ("r", radius)];
        svg.moving(
            "circle",
            &look,
            seconds,
            &[("cx", along(joint, |point| point.0)), ("cy", along(joint, |point| point.1))],
        );
    }
}

fn arm(svg: &mut Svg, plane: &Plane, pose: &Pose, tip: Place, series: &str, opacity: f64) {
    let [shoulder, elbow, tip] = [[0.0, 0.0], pose.elbow, tip].map(|place| plane.point(place));
    let points = [shoulder, elbow, tip].map(|(x, y)| format!("{},{}", number(x), number(y))).join(" ");
    // One line for both links: two would show where they overlap as soon as they are faint.
    let opacity = number(opacity);
    let look = [("class", "s-safe"), ("fill", "none"), ("stroke-width", "7"), ("opacity", &opacity)];
    let ends = [("stroke-linejoin", "round"), ("stroke-linecap", "round"), ("points", &points)];
    svg.element("polyline", &[look.as_slice(), ends.as_slice()].concat());
    svg.circle("f-text", shoulder, 5.0);
    svg.circle("f-on", elbow, 3.0);
    let (class, x, y) = (format!("b-{series}"), number(tip.0), number(tip.1));
    svg.element("circle", &[("class", &class), ("cx", &x), ("cy", &y), ("r", "5"), ("opacity", &opacity)]);
}

/// The target's ring, over the arm that may pass there.
fn target(svg: &mut Svg, plane: &Plane, pose: &Pose) {
    ring(svg, "s-third", plane.point(pose.target), plane.length(0.01).max(6.0), "2.4", "none");
}

/// The number of every tenth step, where it is apart from what is there.
fn numbers(svg: &mut Svg, points: &[(f64, f64)], mut taken: Vec<(f64, f64)>, series: &str) {
    for (step, point) in points.iter().enumerate().skip(NUMBERED).step_by(NUMBERED) {
        if taken.iter().all(|(x, y)| (x - point.0).hypot(y - point.1) >= APART) {
            svg.circle(&format!("b-{series}"), *point, 3.0);
            svg.text("f-text", (point.0, point.1 - 7.0), SMALL, Anchor::Middle, &step.to_string());
            taken.push(*point);
        }
    }
}

/// Length of a film and what is expected of it, in words.
pub(super) fn film_words(film: &Film) -> String {
    format!("{} steps, expected {} in all", film.actions.len(), signed(film.predicted.iter().sum()))
}

/// A frame in words, for those who cannot see its picture.
pub(super) fn frame_words(frame: &Frame) -> String {
    Pose::read(frame).map_or_else(String::new, |pose| pose.words())
}

/// First and last situation of a film in words.
pub(super) fn way_words(film: &Film) -> String {
    let ends = [film.frames.first(), film.frames.last()];
    let [first, last] = ends.map(|frame| frame.map_or_else(String::new, frame_words));
    format!("from {first} to {last}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;
    use mcvl_core::env::Environment;
    use mcvl_core::env::reacher::{Button, ClosedForm, Motion, Reacher};
    use mcvl_core::rng::Rng;

    fn world(button: Option<Button>) -> Reacher {
        Reacher::new(ClosedForm::default(), button)
    }

    fn apart(a: Place, b: Place) -> f64 {
        ((a[0] - b[0]).abs() / CELL[0]).max((a[1] - b[1]).abs() / CELL[1])
    }

    #[test]
    fn positions_are_right_within_a_cell() {
        let mut rng = Rng::new(3);
        let mut world = world(None);
        for _ in 0..500 {
            let mut angle = || PI * (2.0 * rng.uniform_f64() - 1.0);
            let angles = [angle(), angle()];
            let mut within = || 0.14 * (2.0 * rng.uniform_f64() - 1.0);
            world.begin(&Motion::start(angles, [0.0; 2], [within(), within()]));
            let (truth, pose) = (world.pose(), Pose::read(&world.frame()).unwrap());
            for (what, read, place) in [
                ("elbow", pose.elbow, truth.elbow),
                ("tip", pose.tip, truth.tip),
                ("target", pose.target, truth.target),
            ] {
                assert!(apart(read, place) <= 1.0, "{what}: {read:?} for {place:?}, {angles:?}");
            }
            assert!((distance(pose.elbow, pose.tip) - FOREARM).abs() < 1e-9);
        }
    }

    #[test]
    fn hidden_characters_are_found_under_what_hides_them() {
        let mut world = world(None);
        let right = PI / 2.0;
        let read = |world: &Reacher| Pose::read(&world.frame()).unwrap();
        // Target under the fingertip, elbow under the target.
        world.begin(&Motion::start([right, -right], [0.0; 2], [0.11, 0.1]));
        assert!(apart(read(&world).target, [0.11, 0.1]) <= 0.5);
        world.begin(&Motion::start([right, -right], [0.0; 2], [0.0, 0.1]));
        assert!(apart(read(&world).elbow, [0.0, 0.1]) <= 0.5);
        // Fingertip beyond the last row.
        world.begin(&Motion::start([right, 0.0], [0.0; 2], [0.0, -0.1]));
        assert!(apart(read(&world).tip, [0.0, 0.21]) <= 1.0);
        assert_eq!(Pose::read(&Frame { seen: "....\n....".into(), truth: None }), None);
    }

    #[test]
    fn the_way_is_smooth_and_stays_in_its_cells() {
        let check = samples::reach(1);
        let film = &check.modified.as_ref().unwrap().films[0];
        let poses: Vec<Pose> = film.frames.iter().filter_map(Pose::read).collect();
        assert_eq!(poses.len(), 51);
        let way = way(&poses);
        assert!(way.iter().zip(&poses).all(|(place, pose)| apart(*place, pose.cell) <= 1.0));
        let bends = |places: &[Place]| -> f64 {
            let second = |w: &[Place], axis: usize| w[0][axis] - 2.0 * w[1][axis] + w[2][axis];
            places.windows(3).map(|w| second(w, 0).hypot(second(w, 1))).sum()
        };
        let stairs: Vec<Place> = poses.iter().map(|pose| pose.cell).collect();
        assert!(bends(&way) < 0.5 * bends(&stairs), "{} {}", bends(&way), bends(&stairs));
    }

    #[test]
    fn the_button_is_where_the_world_has_it() {
        for button in [Button::proposal(), Button::release()] {
            let mut world = world(Some(button));
            let frames: Vec<Frame> = [0.0, 2.0, 2.4]
                .map(|angle| {
                    world.begin(&Motion::start([angle, 0.3], [0.0; 2], [0.0, -0.1]));
                    world.frame()
                })
                .into();
            let read = Disc::read(frames.iter()).unwrap();
            assert!(apart(read.centre, button.rule().centre) <= 1.0, "{read:?}");
            assert!((read.radius - button.rule().radius).abs() < 0.01, "{read:?}");
        }
        assert_eq!(Disc::read([world(None).frame()].iter()), None);
    }
}
