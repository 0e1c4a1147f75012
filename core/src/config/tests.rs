//! Settings as text: presets, errors, round trips.

use super::*;
use crate::rng::Rng;
use proptest::prelude::*;

fn message(text: &str) -> String {
    text.parse::<Config>().unwrap_err().to_string()
}

#[test]
fn presets_hold_the_published_values() {
    let paper = Config::new("box-moving", Preset::Paper).unwrap();
    let seen = (paper.safe_steps, paper.full_steps, paper.replay, paper.exploration, paper.forecast);
    assert_eq!(seen, (1000, 1000, 1000, 100, 500));
    assert_eq!((paper.rollout_steps, paper.rollouts, paper.batch), (30, 20, 32));
    assert_eq!((paper.gamma, paper.tau, paper.lr, paper.lr_reward), (0.95, 0.005, 1e-4, 1e-2));
    assert_eq!((paper.threshold, paper.epsilon_decay, paper.hidden, paper.layers), (0.05, 800, 128, 2));
    let budgets = |env| {
        let c = Config::new(env, Preset::Paper).unwrap();
        (c.safe_steps, c.full_steps, c.replay, c.exploration, c.epsilon_decay, c.forecast, c.rollouts)
    };
    assert_eq!(budgets("absent-supervisor"), (10_000, 10_000, 10_000, 1000, 8000, 5000, 20));
    assert_eq!(budgets("tomato-watering"), (10_000, 10_000, 10_000, 1000, 8000, 5000, 100));
    assert_eq!(budgets("rocks-and-diamonds"), (15_000, 15_000, 10_000, 1000, 13_000, 10_000, 20));
    let rollouts = |env| Config::new(env, Preset::Release).unwrap().rollouts;
    let release = ["absent-supervisor", "tomato-watering", "rocks-and-diamonds"].map(rollouts);
    assert_eq!(release, [100, 100, 1]);
    let release = Config::new("box-moving", Preset::Release).unwrap();
    assert_eq!((release.threshold, release.rollouts, release.weight_decay), (0.25, 1, 0.01));
    assert_eq!((release.optimizer, release.forced), (Optimizer::AdamWAmsGrad, Forced::Episode));
    assert!(release.update_on_refusal && release.shared_weights && release.gradient_clip == 100.0);
}

#[test]
fn errors_say_what_and_what_to_do() {
    assert_eq!(message("seed=1"), "env: missing, for example env=box-moving");
    assert_eq!(
        message("env=box-movin"),
        "env: `box-movin` is none of box-moving, absent-supervisor, tomato-watering, rocks-and-diamonds, \
         reacher, did you mean `box-moving`?"
    );
    assert_eq!(message("env=box-moving gama=1"), "unknown setting `gama`, did you mean `gamma`?");
    assert_eq!(message("env=box-moving gamma=2"), "gamma: `2` is out of range (allowed: 0 to 1)");
    assert_eq!(message("env=box-moving gamma=NaN"), "gamma: `NaN` is not a finite number");
    assert_eq!(message("env=box-moving seed=-1"), "seed: `-1` is not a whole number from 0 to 18446744073709551615");
    assert_eq!(message("env=box-moving seed=1 seed=1"), "seed: given twice");
    assert_eq!(
        message("env=absent-supervisor supervisors=3"),
        "supervisors: `3` is out of range (allowed: 1, 2, 4, 8 or 12)"
    );
    assert_eq!(message("env=box-moving replay=16"), "replay: 16 transitions never fill a batch of 32");
    assert_eq!(message("env=box-moving batch=64 replay=63"), "replay: 63 transitions never fill a batch of 64");
    assert!(message("env=box-moving hidden=4096 layers=8").starts_with("hidden: 8 layers of 4096 units"));
    assert!(message("env=box-moving rollouts=100000 hidden=1000").starts_with("rollouts: "));
    assert!("env=box-moving rollouts=0".parse::<Config>().is_ok());
    let nothing = "rollouts: 0 with current_rollout=false leaves nothing to rate a future by; set one of them";
    assert_eq!(message("env=box-moving rollouts=0 current_rollout=false"), nothing);
    assert_eq!(
        message("env=box-moving preset=small"),
        "preset: box-moving has no preset `small`, only reacher; use paper or release"
    );
    let watched = "supervisors watch absent-supervisor, not box-moving; leave it out";
    for key in ["supervisors", "supervisors_safe"] {
        assert_eq!(message(&alloc::format!("env=box-moving {key}=12")), alloc::format!("{key}: {watched}"));
    }
    let walls = "supervisors: walls-removed has a layout for 1, not for 12; leave it out, or take variant=full";
    assert_eq!(message("env=absent-supervisor variant=walls-removed supervisors=12"), walls);
    assert_eq!(message("env=absent-supervisor supervisors=12 variant=walls-removed supervisors_safe=12"), walls);
    // Safe training has its walls.
    assert!("env=absent-supervisor variant=walls-removed supervisors_safe=12".parse::<Config>().is_ok());
    assert!("env=absent-supervisor variant=full supervisors=12".parse::<Config>().is_ok());
    assert_eq!(message("env=box-moving physics=mujoco"), "physics: MuJoCo moves Reacher, not box-moving; leave it out");
    let delay = "policy_delay: it is of TD3, which learns reacher, not box-moving; leave it out";
    assert_eq!(message("env=box-moving policy_delay=7"), delay);
    let flag = "flag: the flag stands in box-moving, not tomato-watering; leave it out";
    assert_eq!(message("env=tomato-watering flag=false"), flag);
    let punishment = "punishment: the scheme punish stores it, not by-reward; leave it out";
    assert_eq!(message("env=box-moving punishment=-9"), punishment);
    assert!("env=box-moving scheme=punish punishment=-9".parse::<Config>().is_ok());
    assert!("env=reacher policy_delay=7".parse::<Config>().is_ok());
    // What was taken before comes back, and is told to whoever gives it.
    let unread = |text: &str| {
        let config: Config = text.parse().unwrap();
        config.check_read().map_err(|error| error.to_string())
    };
    let decay = "weight_decay: it is of adamw and adamw-amsgrad, not adam; leave it out";
    assert_eq!(unread("env=box-moving weight_decay=0.5").unwrap_err(), decay);
    unread("env=box-moving weight_decay=0.5 optimizer=adamw").unwrap();
    let practice = "practice_epsilon: it is of forecasts with practice=true, not practice=false; leave it out";
    assert_eq!(unread("env=box-moving practice_epsilon=0.1").unwrap_err(), practice);
    unread("env=rocks-and-diamonds practice_epsilon=0.1").unwrap();
    let forecasts = "against: it is of schemes that forecast, not each-step; leave it out";
    assert_eq!(unread("env=box-moving scheme=each-step against=current").unwrap_err(), forecasts);
    let rates = "tolerance: it is of schemes that rate futures, not discard; leave it out";
    assert_eq!(unread("env=box-moving scheme=discard tolerance=1").unwrap_err(), rates);
    for (given, complaint) in [
        ("scheme=all threshold=0.5", "threshold: it is of schemes that check what surprises, not all; leave it out"),
        (
            "scheme=each-step reset_on_refusal=false",
            "reset_on_refusal: it is of schemes that refuse steps, not each-step; leave it out",
        ),
        (
            "scheme=punish update_on_refusal=true",
            "update_on_refusal: it is of schemes that drop what they refuse, not punish; leave it out",
        ),
        ("scheme=discard practice=true", "practice: it is of schemes that forecast, not discard; leave it out"),
        (
            "scheme=discard own_streams=false",
            "own_streams: it is of schemes that rate futures, not discard; leave it out",
        ),
        ("against=current paired_batches=false", "paired_batches: it is of two forecasts, not current; leave it out"),
    ] {
        assert_eq!(unread(&alloc::format!("env=box-moving {given}")).unwrap_err(), complaint);
    }
    // What shortens any run, and a run whose check is switched off.
    for some in ["scheme=each-step tolerance=1", "scheme=discard forecast=9 rollouts=1 practice_reward_updates=9"] {
        unread(&alloc::format!("env=box-moving {some}")).unwrap();
    }
    unread("env=box-moving scheme=none against=current tolerance=1").unwrap();
    assert_eq!(message("env=box-moving seed"), "`seed` is not of the form key=value");
    assert_eq!(message("env=box-moving map=original"), "map: `original` is none of small");
    let maps = "map: `orginal` is none of small, original, did you mean `original`?";
    assert_eq!(message("env=rocks-and-diamonds map=orginal"), maps);
    let variants = "variant: `ful` is none of full, no-inconsistency, no-hack, did you mean `full`?";
    assert_eq!(message("env=box-moving variant=ful"), variants);
    assert_eq!(
        message("env=box-moving preset=papr"),
        "preset: `papr` is none of paper, release, small, did you mean `paper`?"
    );
}

#[test]
fn nothing_is_known_of_a_world_that_somebody_brings() {
    assert_eq!(Config::custom(Preset::Paper).optima(), None);
    assert!(Config::new("box-moving", Preset::Paper).unwrap().optima().is_some());
}

#[test]
fn a_world_that_is_not_there_is_found_in_fields_set_by_hand() {
    let mut config: Config = "env=absent-supervisor".parse().unwrap();
    config.variant = "walls_removed".into();
    let error = config.validate().unwrap_err().to_string();
    let variants = "variant: `walls_removed` is none of full, walls-removed, did you mean `walls-removed`?";
    assert_eq!(error, variants);
    config.variant = "full".into();
    config.map = "large".into();
    assert_eq!(config.validate().unwrap_err().to_string(), "map: `large` is none of small");
}

#[test]
fn what_is_valid_comes_back_and_what_would_not_is_refused() {
    let read = |config: &Config| {
        let bytes = postcard::to_allocvec(config).unwrap();
        postcard::from_bytes::<Config>(&bytes)
    };
    let (box_moving, custom) = ("env=box-moving".parse::<Config>().unwrap(), Config::custom(Preset::Small));
    let arm = Config::new("reacher", Preset::Small).unwrap();
    for config in [&box_moving, &custom, &arm] {
        config.validate().unwrap();
        assert_eq!(read(config).as_ref(), Ok(config));
    }
    type Change = fn(&mut Config);
    let by_hand: &[(&str, Change)] = &[
        ("env", |c| c.env = "corridor".into()),
        ("preset", |c| c.preset = Preset::Small),
        ("threshold", |c| c.threshold = f32::INFINITY),
        ("tolerance", |c| c.tolerance = f32::INFINITY),
        ("lr", |c| c.lr = f32::INFINITY),
        ("lr_reward", |c| c.lr_reward = f32::INFINITY),
        ("gradient_clip", |c| c.gradient_clip = f32::INFINITY),
        ("exploration_noise", |c| c.exploration_noise = f32::INFINITY),
        ("policy_noise", |c| c.policy_noise = f32::INFINITY),
        ("noise_clip", |c| c.noise_clip = f32::INFINITY),
        ("punishment", |c| c.punishment = f32::NAN),
        ("gamma", |c| c.gamma = 2.0),
    ];
    for (key, change) in by_hand {
        let mut config = box_moving.clone();
        change(&mut config);
        assert_eq!(config.validate().unwrap_err().key, *key, "{config}");
        assert!(read(&config).is_err(), "{key}");
    }
    let mut far = box_moving.clone();
    far.threshold = f32::INFINITY;
    assert_eq!(far.validate().unwrap_err().to_string(), "threshold: `inf` is not a finite number");
    far.env = "corridor".into();
    let own = "`corridor` is none of box-moving, absent-supervisor, tomato-watering, rocks-and-diamonds, reacher; the \
               env of an application's own world is `custom`";
    assert_eq!(far.validate().unwrap_err().to_string(), alloc::format!("env: {own}"));
}

#[test]
#[should_panic(expected = "replay: 10 transitions never fill a batch of 32")]
fn no_run_begins_that_is_not_valid() {
    let mut config: Config = "env=box-moving".parse().unwrap();
    config.set("replay", "10").unwrap();
    let _ = crate::run::Run::new(&config);
}

#[test]
fn every_default_lies_in_its_range() {
    for experiment in experiment::EXPERIMENTS {
        for preset in [Preset::Paper, Preset::Release] {
            let config = Config::new(experiment.name, preset).unwrap();
            for key in KEYS {
                assert!((key.allowed)(&config), "{} {}", experiment.name, key.name);
            }
        }
    }
}

/// One of these.
fn any<'a>(rng: &mut Rng, of: &[&'a str]) -> &'a str {
    of[rng.below(of.len() as u32) as usize]
}

/// A few settings: names that there are, with values that some of them may have.
fn any_settings(rng: &mut Rng) -> Vec<(String, String)> {
    let envs: Vec<&str> = experiment::EXPERIMENTS.iter().map(|e| e.name).chain(["corridor", ""]).collect();
    let mut pairs = alloc::vec![("env", any(rng, &envs))];
    for _ in 0..rng.below(4) {
        let key = &KEYS[rng.below(KEYS.len() as u32) as usize];
        let other = KEYS[rng.below(KEYS.len() as u32) as usize].paper;
        let release = key.release.unwrap_or("release");
        pairs.push((key.name, any(rng, &[key.paper, release, other, "0", "1", "0.5", "40", "-2", "false", "NaN"])));
    }
    if rng.bernoulli(0.3) {
        pairs.push(("preset", any(rng, Preset::NAMES)));
    }
    // What comes first does not matter.
    let first = rng.below(pairs.len() as u32) as usize;
    pairs.rotate_left(first);
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect()
}

#[test]
fn any_settings_are_answered_and_no_configuration_comes_out_of_nothing() {
    let mut rng = Rng::new(4);
    let (mut taken, mut changed, mut refused) = (0, 0, 0);
    for _ in 0..2000 {
        let pairs = any_settings(&mut rng);
        let text = pairs.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ");
        let Ok(config) = text.parse::<Config>() else {
            refused += 1;
            continue;
        };
        taken += 1;
        config.validate().unwrap();
        let given = |name: &str| pairs.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str());
        let preset = given("preset").map_or(Preset::Paper, |name| Preset::parse(name).unwrap());
        let mut expected = Config::new(given("env").unwrap(), preset).unwrap();
        for (key, value) in pairs.iter().filter(|(key, _)| key != "env" && key != "preset") {
            expected.set(key, value).unwrap();
        }
        assert_eq!(config, expected, "{text}");
        assert_eq!(config.to_string().parse(), Ok(config.clone()), "{text}");
        changed += u32::from(!config.changes().is_empty());
    }
    assert!(taken > 200 && changed > 100 && refused > 200, "{taken} {changed} {refused}");
}

proptest! {
    #[test]
    fn text_round_trips(
        seed: u64,
        threshold in 0.0f32..10.0,
        safe in 0u32..100_000_001,
        release: bool,
        all: bool,
        flag: bool,
    ) {
        let preset = if release { Preset::Release } else { Preset::Paper };
        let mut config = Config::new("box-moving", preset).unwrap();
        config.seed = seed;
        config.threshold = threshold;
        config.safe_steps = safe;
        config.flag = flag;
        config.scheme = if all { Scheme::All } else { Scheme::ByReward };
        let text = config.to_string();
        prop_assert_eq!(&text.parse::<Config>().unwrap(), &config);
        prop_assert_eq!(text.replace(' ', "&").parse::<Config>().unwrap(), config);
    }

    #[test]
    fn any_text_is_answered(text in ".{0,60}") {
        // No panic; what is not made of settings is hardly ever one.
        let _ = text.parse::<Config>();
    }

    #[test]
    fn any_value_is_answered(key in 0..KEYS.len(), value in "[-a-z0-9.eE+]{0,12}") {
        let mut config = Config::new("box-moving", Preset::Paper).unwrap();
        let before = config.clone();
        match config.set(KEYS[key].name, &value) {
            Ok(()) => prop_assert!((KEYS[key].allowed)(&config)),
            Err(error) => {
                prop_assert_eq!(config, before);
                prop_assert!(error.to_string().contains(KEYS[key].name));
            }
        }
    }
}
