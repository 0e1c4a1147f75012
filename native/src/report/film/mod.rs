//! One check as a story: the offered transition, both futures as film strips, the ratings, the verdict,
//! and, last, the truth that the check did not see.

mod arm;
mod picture;
mod terminal;

use mcvl_core::env::{EnvSpec, Frame};
use mcvl_core::record::{CheckRecord, Film, FutureRecord, StartState, Subject, Verdict};

pub(super) use picture::{picture_legend, ratings, situation, way};
pub use picture::{png, svg};
pub use terminal::{board, explain};

/// Longest cycle that is looked for.
const LONGEST_CYCLE: usize = 8;
/// Frames of a film without a cycle that are shown before it is cut.
const LONGEST_START: usize = 12;
/// Boards wider than this are pictures, not grids: their cells are not square, and most of them are empty.
const GRID: usize = 20;

/// A part of a film strip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Part {
    /// The frame after this many steps.
    Frame(usize),
    /// Steps left out.
    Gap {
        /// Frames of the cycle that goes on in the gap, or `None` where there is none.
        cycle: Option<usize>,
        /// Steps left out.
        steps: usize,
        /// Sum of the rewards predicted for them, scaled.
        predicted: f32,
    },
}

/// What a strip shows of a film: all of it, or one round of the cycle in which it ends, or its start.
pub(super) fn parts(film: &Film) -> Vec<Part> {
    let steps = film.actions.len();
    let (shown, cycle) = match cycle(film) {
        Some((start, period)) => (start + period - 1, Some(period)),
        None => (LONGEST_START, None),
    };
    // A gap of one or two steps would save no room.
    if shown + 2 >= steps {
        return (0..=steps).map(Part::Frame).collect();
    }
    let predicted = film.predicted.iter().skip(shown).sum();
    let gap = Part::Gap { cycle, steps: steps - shown, predicted };
    (0..=shown).map(Part::Frame).chain([gap]).collect()
}

/// Steps of a film that stand for all of it: its start, about every tenth of a long one, its end.
fn milestones(film: &Film) -> Vec<usize> {
    let steps = film.actions.len();
    let parts = (steps / 10).clamp(5, 8).min(steps).max(1);
    let mut milestones: Vec<usize> = (0..=parts).map(|part| part * steps / parts).collect();
    milestones.dedup();
    milestones
}

/// The cycle in which a film ends, as (first step, length): the one that leaves least to be shown.
fn cycle(film: &Film) -> Option<(usize, usize)> {
    let steps = film.actions.len();
    let same = |a: usize, b: usize| film.frames[a] == film.frames[b] && film.actions[a - 1] == film.actions[b - 1];
    let start = |period: usize| {
        let broken = (1..=steps.saturating_sub(period)).rev().find(|step| !same(*step, step + period));
        broken.map_or(1, |step| step + 1)
    };
    (1..=LONGEST_CYCLE)
        .map(|period| (start(period), period))
        // Twice is chance, three times a cycle.
        .filter(|(start, period)| start + 3 * period <= steps + 1)
        .min_by_key(|(start, period)| start + period)
}

/// A scaled reward with its sign and two decimals; what rounds to zero has no minus.
pub(super) fn signed(reward: f32) -> String {
    let text = format!("{reward:+.2}");
    if text == "-0.00" { "+0.00".into() } else { text }
}

/// A gap in words.
pub(super) fn gap_words(cycle: Option<usize>, steps: usize, predicted: f32) -> String {
    let how = match cycle {
        Some(1) => format!("the last step again for {steps} more"),
        Some(period) => format!("the last {period} steps again and again for {steps} more"),
        None => format!("{steps} more steps"),
    };
    format!("{how}, expected {} in all", signed(predicted))
}

/// Where a film starts, in words.
pub(super) fn start_words(start: StartState) -> &'static str {
    match start {
        StartState::Reset => "from a new episode",
        StartState::Current => "from the state after the transition",
    }
}

/// The action that leads to a frame, and the reward predicted for it; empty for the first frame.
pub(super) fn caption(film: &Film, step: usize, names: &EnvSpec) -> (String, String) {
    if step == 0 {
        return ("start".into(), String::new());
    }
    let predicted = film.predicted.get(step - 1).map_or(String::new(), |reward| signed(*reward));
    (format!("{step} {}", names.actions.name(&film.actions[step - 1])), predicted)
}

/// Both futures with what they are called; none where nothing was forecast.
pub(super) fn futures(check: &CheckRecord) -> Vec<(&'static str, &FutureRecord)> {
    let names = match check.subject {
        Subject::Transition => ("If it learns from it", "If it does not"),
        Subject::Update => ("After the update", "Before the update"),
    };
    let pair = |(modified, unmodified, _)| vec![(names.0, modified), (names.1, unmodified)];
    check.futures().map_or(Vec::new(), pair)
}

/// Both futures with a short name, at most ten letters.
pub(super) fn short_futures(check: &CheckRecord) -> Vec<(&'static str, &FutureRecord)> {
    let names = match check.subject {
        Subject::Transition => ["with it", "without it"],
        Subject::Update => ["after it", "before it"],
    };
    names.into_iter().zip(futures(check)).map(|(name, (_, future))| (name, future)).collect()
}

/// Expected and received, in words.
pub(super) fn surprise_words(check: &CheckRecord) -> String {
    let off = (check.reward - check.predicted).abs();
    let why = match (check.subject, check.futures()) {
        (Subject::Update, _) => "the update after it is checked, whatever it learns from".into(),
        (_, None) => format!("from {} it is discarded, without a forecast", check.threshold),
        _ => format!("checked from {}", check.threshold),
    };
    format!(
        "Expected {}, received {} (raw {:+}): off by {off:.2}, {why}.",
        signed(check.predicted),
        signed(check.reward),
        check.reward_raw,
    )
}

/// The verdict in one sentence.
pub(super) fn verdict_words(check: &CheckRecord) -> String {
    let Some(margin) = check.margin else {
        return "REFUSED: what surprises is discarded, and nobody asked what it would lead to.".into();
    };
    let difference = margin.abs();
    if check.subject == Subject::Update {
        return match check.verdict {
            Verdict::Refuse => format!(
                "REFUSED: rated by what it wanted before it, the update makes the policy worse by {difference:.3}; \
                 it is taken back."
            ),
            Verdict::Accept => format!("ACCEPTED: the update stays (difference {margin:+.3})."),
        };
    }
    match check.verdict {
        Verdict::Refuse => {
            let instead = check.replaced.map_or(String::new(), |reward| format!(" Stored as {}.", signed(reward)));
            format!(
                "REFUSED: rated by what it wants today, the future that learns from it is worse by \
                 {difference:.3}.{instead}"
            )
        }
        Verdict::Accept if check.tie => "ACCEPTED: both futures are rated exactly equal, and a tie accepts.".into(),
        Verdict::Accept if margin < 0.0 => "ACCEPTED: the futures differ by less than the tolerance.".into(),
        Verdict::Accept => {
            format!("ACCEPTED: rated by what it wants today, learning from it is better by {difference:.3}.")
        }
    }
}

/// The truth in one sentence: what the transition was, and whether the decision was right.
pub(super) fn truth_words(check: &CheckRecord) -> String {
    let worth = format!("it paid {:+} and was worth {:+}", check.reward_raw, check.performance);
    if check.subject == Subject::Update {
        let kind = if check.hack { "a hack" } else { "honest" };
        return format!("the step was {kind} ({worth}); of a whole mini-batch nothing is right or wrong.");
    }
    match (check.hack, check.verdict) {
        (true, Verdict::Refuse) => format!("a hack ({worth}). Refusing was right."),
        (true, Verdict::Accept) => format!("a hack ({worth}). Accepting was WRONG: a hack was learned."),
        (false, Verdict::Accept) => format!("honest ({worth}). Accepting was right."),
        (false, Verdict::Refuse) => format!("honest ({worth}). Refusing was WRONG: it was no hack."),
    }
}

/// Rollouts in words, equal ones counted: `20 x -1.392, 1 x -1.205`.
pub(super) fn rollout_words(rollouts: &[f64]) -> String {
    let mut groups: Vec<(String, usize)> = Vec::new();
    for utility in rollouts {
        let text = format!("{utility:+.3}");
        match groups.last_mut() {
            Some((last, count)) if *last == text => *count += 1,
            _ => groups.push((text, 1)),
        }
    }
    groups.iter().map(|(text, count)| format!("{count} x {text}")).collect::<Vec<_>>().join(", ")
}

/// The characters that occur, with their meaning.
pub fn legend_of(names: &EnvSpec, frames: &[&Frame]) -> String {
    let occurs = |cell: char| frames.iter().any(|frame| frame.seen.contains(cell));
    let entries = names.legend.iter().filter(|(cell, _)| *cell != ' ' && occurs(*cell));
    let told: Vec<String> = entries.map(|(cell, meaning)| format!("{cell} {meaning}")).collect();
    told.join("; ")
}

/// What the strips of a check show.
pub(super) fn legend(check: &CheckRecord, names: &EnvSpec) -> String {
    let films = check.modified.iter().chain(&check.unmodified).flat_map(|future| &future.films);
    let shown: Vec<&Frame> = films.flat_map(|film| &film.frames).chain([&check.before, &check.after]).collect();
    // Of a picture the truth is shown too.
    let picture = is_picture(&check.after.seen);
    let truth = check.after.truth.clone().filter(|_| picture).map(|seen| Frame { seen, truth: None });
    let told = legend_of(names, &shown.into_iter().chain(&truth).collect::<Vec<_>>());
    match (check.futures(), picture) {
        (None, _) => format!("{told}."),
        (_, false) => format!("{told}. Under a frame: the reward it expects for that step."),
        (_, true) => format!("{told}. Under a frame: the steps that lead to it, and the reward it expects for them."),
    }
}

/// Whether a board is a picture and no grid.
fn is_picture(board: &str) -> bool {
    board.split('\n').any(|row| row.chars().count() > GRID)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;

    #[test]
    fn decisions_of_every_scheme_are_told() {
        let discard = samples::discard(3, true);
        assert!(futures(&discard).is_empty() && legend(&discard, &samples::spec()).ends_with('.'));
        assert!(surprise_words(&discard).contains("from 0.05 it is discarded, without a forecast"));
        assert!(verdict_words(&discard).starts_with("REFUSED: what surprises is discarded"));
        assert!(truth_words(&discard).ends_with("Refusing was right."));
        assert!(truth_words(&samples::discard(3, false)).contains("WRONG"));
        let text = explain(&discard, None, &samples::spec(), 80, false);
        assert!(text.contains("REFUSED") && !text.contains("Rated") && !text.contains("rollouts"), "{text}");
        assert!(svg(&discard, &samples::spec()).contains("REFUSED"));

        let update = samples::update(4, Verdict::Refuse);
        assert_eq!(futures(&update)[1].0, "Before the update");
        assert!(verdict_words(&update).contains("it is taken back"));
        assert!(verdict_words(&samples::update(4, Verdict::Accept)).contains("the update stays"));
        assert!(truth_words(&update).contains("nothing is right or wrong"));
        let text = explain(&update, None, &samples::spec(), 80, false);
        assert!(text.contains("rollouts before it"), "{text}");

        let mut punished = samples::check(5, true, Verdict::Refuse);
        punished.replaced = Some(-2.0);
        assert!(verdict_words(&punished).ends_with("Stored as -2.00."));
    }

    #[test]
    fn a_cycle_is_shown_once() {
        // d d u d u d ...: after the first step, pressing 4 and 3 in turn.
        let film = samples::check(1, true, Verdict::Refuse).modified.unwrap().films.remove(0);
        let parts = parts(&film);
        assert!(matches!(parts.last(), Some(Part::Gap { cycle: Some(2), .. })), "{parts:?}");
        let shown = parts.len() - 1;
        let Some(Part::Gap { steps, predicted, .. }) = parts.last() else { unreachable!() };
        assert_eq!(shown - 1 + steps, 30, "every step is shown or counted");
        assert!(shown <= 6 && *predicted < 0.0, "{parts:?}");
    }

    #[test]
    fn short_and_irregular_films_are_shown_as_they_are() {
        let mut film = samples::check(1, true, Verdict::Refuse).modified.unwrap().films[0].clone();
        film.frames.truncate(4);
        film.actions.truncate(3);
        film.predicted.truncate(3);
        assert_eq!(parts(&film), [0, 1, 2, 3].map(Part::Frame));
        film.frames.truncate(1);
        film.actions.clear();
        assert_eq!(parts(&film), [Part::Frame(0)]);
    }

    #[test]
    fn long_films_without_a_cycle_are_cut() {
        let mut film = samples::check(1, true, Verdict::Refuse).modified.unwrap().films[0].clone();
        for (index, frame) in film.frames.iter_mut().enumerate() {
            frame.seen = index.to_string();
        }
        let gap = parts(&film).last().copied();
        assert!(matches!(gap, Some(Part::Gap { cycle: None, steps: 18, .. })), "{gap:?}");
    }

    #[test]
    fn milestones_reach_from_the_start_to_the_end() {
        let mut film = samples::reach(1).modified.unwrap().films.remove(0);
        let mut at = |steps: usize| {
            film.actions.resize(steps, mcvl_core::env::ActionValue::Discrete(0));
            milestones(&film)
        };
        assert_eq!(at(50), [0, 10, 20, 30, 40, 50]);
        assert_eq!(at(13), [0, 2, 5, 7, 10, 13]);
        assert_eq!((at(3), at(1), at(0)), (vec![0, 1, 2, 3], vec![0, 1], vec![0]));
        assert_eq!((at(1000).len(), at(1000)[8]), (9, 1000));
    }

    #[test]
    fn the_truth_names_wrong_decisions() {
        let words = |hack, verdict| truth_words(&samples::check(1, hack, verdict));
        assert!(words(true, Verdict::Accept).contains("WRONG") && words(false, Verdict::Refuse).contains("WRONG"));
        assert!(!words(true, Verdict::Refuse).contains("WRONG") && !words(false, Verdict::Accept).contains("WRONG"));
    }

    #[test]
    fn zero_has_no_minus() {
        assert_eq!([-0.001, 0.0, -0.006, 1.0].map(signed), ["+0.00", "+0.00", "-0.01", "+1.00"]);
    }

    #[test]
    fn equal_rollouts_are_counted() {
        assert_eq!(rollout_words(&[1.0, 1.0, -0.5]), "2 x +1.000, 1 x -0.500");
    }
}
