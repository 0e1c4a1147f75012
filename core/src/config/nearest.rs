//! What somebody meant who wrote a name that there is not.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

/// Most edits that are a slip of the hand, whatever else the text looks like.
const SLIP: usize = 2;
/// Fewest letters that stand for the name that they begin.
const BEGINNING: usize = 3;

/// «`x` is none of a, b, c (did you mean `a`?)».
pub fn expected_one_of(text: &str, names: &[&str]) -> String {
    let hint = nearest(text, names).map_or(String::new(), |name| format!(", did you mean `{name}`?"));
    format!("`{text}` is none of {}{hint}", names.join(", "))
}

/// The name that `text` was meant to be, if one can be told: a slip away, else one that it begins with or that begins
/// with it, else the nearest that is near enough. A number is no misspelling of another, so digits have to be the same.
pub fn nearest<'a>(text: &str, names: &[&'a str]) -> Option<&'a str> {
    let digits = |of: &str| of.bytes().filter(u8::is_ascii_digit).collect::<Vec<u8>>();
    // The least rank is meant: how it is alike, then how much.
    let mut best: Option<([usize; 3], &str)> = None;
    for name in names.iter().copied().filter(|name| digits(name) == digits(text)) {
        let (edits, near) = (edit_distance(text, name), 1 + name.chars().count() / 3);
        let apart = usize::MAX - text.chars().zip(name.chars()).take_while(|(a, b)| a == b).count();
        let begins = text.starts_with(name) || (text.chars().count() >= BEGINNING && name.starts_with(text));
        let rank = match edits {
            0..=SLIP if edits <= near => [0, edits, apart],
            _ if begins => [1, apart, edits],
            _ if edits <= near => [2, edits, apart],
            _ => continue,
        };
        if best.is_none_or(|(known, _)| rank < known) {
            best = Some((rank, name));
        }
    }
    best.map(|(_, name)| name)
}

/// Levenshtein distance.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = core::mem::replace(&mut row[0], i + 1);
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{KEYS, Learner, Scheme};

    #[test]
    fn names_are_told_from_slips_and_beginnings() {
        let keys: Vec<&str> = KEYS.iter().map(|key| key.name).collect();
        let targets = ["all", "fig3", "fig3e", "fig4a", "fig4b", "fig5", "table", "E1", "E2", "E20"];
        for (names, text, meant) in [
            (Scheme::NAMES, "punishment", "punish"),
            (Scheme::NAMES, "store", "store-predicted"),
            (&["full", "walls-removed"], "walls", "walls-removed"),
            (&targets, "fig5a", "fig5"),
            (&targets, "fig3f", "fig3"),
            (&targets, "fig4", "fig4a"),
            (&targets, "e20", "E20"),
            // A longer name with a slip is meant, not the shorter one with which it begins.
            (Learner::NAMES, "frozen_reward", "frozen-reward"),
            (&keys, "threshold_inclsve", "threshold_inclusive"),
            (&keys, "lr_rward", "lr_reward"),
            // The longest beginning, and before what is far.
            (&keys, "practice_reward_updates_all", "practice_reward_updates"),
            (&keys, "replay_steps", "replay"),
            (&keys, "policy", "policy_noise"),
            (&keys, "rollout", "rollouts"),
            (&keys, "treshold", "threshold"),
            (&keys, "evaluatoins_episdes", "evaluation_episodes"),
        ] {
            assert_eq!(nearest(text, names), Some(meant), "{text}");
        }
    }

    #[test]
    fn no_name_is_told_from_too_little() {
        let keys: Vec<&str> = KEYS.iter().map(|key| key.name).collect();
        for (names, text) in [
            (&["small", "original"][..], "large"),
            (&["E1", "E2", "E20"], "E21"),
            (&["fig4a", "fig4b", "fig5"], "fig6"),
            (&["full", "walls-removed"], "wa"),
            (&["small", "original"], ""),
            (&["small", "original"], "日本語"),
            (&keys, "quantum"),
            (&[], "seed"),
        ] {
            assert_eq!(nearest(text, names), None, "{text}");
        }
    }
}
