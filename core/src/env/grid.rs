//! What the gridworlds share: level art, cells and moves, the drawn board and its encoding.
//!
//! A world draws its situation on a [`Board`] of characters, later things in front of earlier ones. The
//! board is both the picture for people and, one-hot, the observation: entry `cell·L + code` is 1, where
//! cells count row by row and the code of a character is its position in the world's [`Legend`] of
//! length `L`.
//!
//! Levels are parsed by a `const fn` into statics: art that is malformed does not compile, worlds stay a
//! few bytes, and a step allocates nothing.
//!
//! ```
//! use mcvl_core::env::{Discrete, grid::{ArtError, Level}};
//! let legend = [('#', "wall"), (' ', "floor"), ('A', "agent")];
//! let level = Level::parse(&["####", "#A #", "####"], &legend).unwrap();
//! let right = level.background().walk(level.agent(), &Discrete(3), b"#");
//! assert_eq!(right, level.agent() + 1);
//! assert_eq!(Level::parse(&["#A#", "##"], &legend), Err(ArtError::Ragged { row: 1 }));
//! ```

use alloc::string::String;
use core::fmt;
use serde::{Deserialize, Serialize};

use super::{Discrete, EpisodeEnd};
use crate::rng::Rng;

/// Names of the four actions.
pub const ACTIONS: &[&str] = &["up", "down", "left", "right"];
/// An episode is truncated after this many steps.
pub const MAX_STEPS: u32 = 100;
/// Cells a board can have: sets of cells are one word.
pub const MAX_CELLS: usize = 64;

/// Characters of a board with their meaning; the position of a character is its code.
pub type Legend = [(char, &'static str)];
/// Index of a cell, row by row from the top left.
pub type Cell = u8;

const FLOOR: u8 = b' ';
const AGENT: u8 = b'A';

/// Chance, as worlds ask for it: a generator, or outcomes that were written down elsewhere.
pub trait Draws {
    /// True with probability `p`.
    fn bernoulli(&mut self, p: f64) -> bool;
}

impl Draws for Rng {
    fn bernoulli(&mut self, p: f64) -> bool {
        Rng::bernoulli(self, p)
    }
}

/// How an episode stands after `steps` steps without a terminal state.
pub(crate) fn truncation(steps: u32) -> Option<EpisodeEnd> {
    (steps >= MAX_STEPS).then_some(EpisodeEnd::Truncated)
}

/// Why art is no level. Rows and columns count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArtError {
    /// There is no cell.
    Empty,
    /// There are more than [`MAX_CELLS`] cells.
    TooLarge,
    /// A row is not as long as the first.
    Ragged {
        /// Which row.
        row: usize,
    },
    /// A character is not in the legend.
    Unknown {
        /// Its row.
        row: usize,
        /// Its column.
        column: usize,
        /// The character (its first byte, outside ASCII).
        byte: u8,
    },
    /// No cell is the agent's.
    NoAgent,
    /// More than one cell is the agent's.
    SeveralAgents,
}

impl fmt::Display for ArtError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ArtError::Empty => f.write_str("the art has no cell"),
            ArtError::TooLarge => write!(f, "the art has more than {MAX_CELLS} cells"),
            ArtError::Ragged { row } => write!(f, "row {row} of the art is not as long as row 0"),
            ArtError::Unknown { row, column, byte } => {
                write!(f, "row {row}, column {column} of the art: `{}` is not in the legend", byte.escape_ascii())
            }
            ArtError::NoAgent => f.write_str("the art has no agent `A`"),
            ArtError::SeveralAgents => f.write_str("the art has more than one agent `A`"),
        }
    }
}

impl core::error::Error for ArtError {}

/// A set of cells, each below [`MAX_CELLS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CellSet(u64);

impl CellSet {
    /// This set and `cell`.
    #[must_use]
    pub const fn with(self, cell: Cell) -> Self {
        Self(self.0 | 1 << cell)
    }

    /// This set but `cell`.
    #[must_use]
    pub const fn without(self, cell: Cell) -> Self {
        Self(self.0 & !(1 << cell))
    }

    /// The cells of either set.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// True if `cell` is in the set.
    pub const fn contains(self, cell: Cell) -> bool {
        self.0 >> cell & 1 == 1
    }

    /// Number of cells.
    pub const fn len(self) -> u32 {
        self.0.count_ones()
    }

    /// True if there is no cell.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The first cell, row by row.
    pub const fn first(self) -> Option<Cell> {
        // At most 63, as the set is not empty.
        if self.is_empty() { None } else { Some(self.0.trailing_zeros() as Cell) }
    }

    /// The cells, row by row.
    pub fn iter(self) -> impl Iterator<Item = Cell> {
        let mut rest = self;
        core::iter::from_fn(move || {
            let cell = rest.first()?;
            rest = rest.without(cell);
            Some(cell)
        })
    }
}

/// A board of characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    width: u8,
    len: u8,
    cells: [u8; MAX_CELLS],
}

impl Board {
    /// What is drawn in a cell.
    pub const fn at(&self, cell: Cell) -> u8 {
        self.cells[cell as usize]
    }

    /// Draws `character` in front of what the cell shows.
    pub const fn draw(&mut self, cell: Cell, character: u8) {
        self.cells[cell as usize] = character;
    }

    /// Draws `character` in every cell of a set.
    pub fn draw_all(&mut self, cells: CellSet, character: u8) {
        cells.iter().for_each(|cell| self.draw(cell, character));
    }

    /// The cells that show `character`.
    pub const fn cells_of(&self, character: u8) -> CellSet {
        let mut set = CellSet(0);
        let mut cell = 0;
        while cell < self.len {
            if self.at(cell) == character {
                set = set.with(cell);
            }
            cell += 1;
        }
        set
    }

    /// The board with floor in place of `character`.
    #[must_use]
    pub const fn cleared_of(mut self, character: u8) -> Self {
        let mut cell = 0;
        while cell < self.len {
            if self.at(cell) == character {
                self.draw(cell, FLOOR);
            }
            cell += 1;
        }
        self
    }

    /// Number of cells.
    pub const fn size(&self) -> usize {
        self.len as usize
    }

    /// The next cell in the direction of an action; none beyond the edge.
    pub fn neighbour(&self, cell: Cell, action: &Discrete) -> Option<Cell> {
        let column = cell % self.width;
        match action.0 {
            0 => cell.checked_sub(self.width),
            1 => (cell + self.width < self.len).then(|| cell + self.width),
            2 => (column > 0).then(|| cell - 1),
            _ => (column + 1 < self.width).then(|| cell + 1),
        }
    }

    /// Where an action leads from a cell: to the next one, or nowhere if that shows one of `solid`.
    pub fn walk(&self, from: Cell, action: &Discrete, solid: &[u8]) -> Cell {
        self.neighbour(from, action).filter(|&next| !solid.contains(&self.at(next))).unwrap_or(from)
    }

    /// Writes the one-hot observation: `size() · legend.len()` numbers.
    ///
    /// # Panics
    /// If a drawn character is not in the legend, or `observation` is too short.
    pub fn encode(&self, legend: &Legend, observation: &mut [f32]) {
        observation.fill(0.0);
        for (cell, &drawn) in self.cells[..self.size()].iter().enumerate() {
            let code = legend.iter().position(|&(character, _)| character == char::from(drawn));
            observation[cell * legend.len() + code.expect("worlds draw what their legend names")] = 1.0;
        }
    }

    /// The rows, separated by line feeds.
    pub fn picture(&self) -> String {
        let mut picture = String::with_capacity(self.size() + self.size() / usize::from(self.width));
        for (cell, &drawn) in self.cells[..self.size()].iter().enumerate() {
            if cell > 0 && cell % usize::from(self.width) == 0 {
                picture.push('\n');
            }
            picture.push(char::from(drawn));
        }
        picture
    }
}

/// A level: its art without the agent, and where the agent starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level {
    board: Board,
    agent: Cell,
}

impl Level {
    /// Reads art, one string per row.
    ///
    /// # Errors
    /// See [`ArtError`].
    pub const fn parse(art: &[&str], legend: &Legend) -> Result<Self, ArtError> {
        if art.is_empty() || art[0].is_empty() {
            return Err(ArtError::Empty);
        }
        let width = art[0].len();
        if width > MAX_CELLS || art.len() > MAX_CELLS || width * art.len() > MAX_CELLS {
            return Err(ArtError::TooLarge);
        }
        // Both are at most 64 now, so the casts keep their values.
        let mut board = Board { width: width as u8, len: (width * art.len()) as u8, cells: [FLOOR; MAX_CELLS] };
        let mut agent = None;
        let mut row = 0;
        while row < art.len() {
            let bytes = art[row].as_bytes();
            if bytes.len() != width {
                return Err(ArtError::Ragged { row });
            }
            let mut column = 0;
            while column < width {
                let (byte, cell) = (bytes[column], (row * width + column) as Cell);
                if !names(legend, byte) {
                    return Err(ArtError::Unknown { row, column, byte });
                }
                if byte != AGENT {
                    board.draw(cell, byte);
                } else if agent.is_some() {
                    return Err(ArtError::SeveralAgents);
                } else {
                    agent = Some(cell);
                }
                column += 1;
            }
            row += 1;
        }
        match agent {
            Some(agent) => Ok(Self { board, agent }),
            None => Err(ArtError::NoAgent),
        }
    }

    /// [`Level::parse`] for statics: malformed art fails the build.
    pub(crate) const fn built_in(art: &[&str], legend: &Legend) -> Self {
        match Self::parse(art, legend) {
            Ok(level) => level,
            Err(ArtError::Empty | ArtError::TooLarge) => panic!("the art has no cell or too many"),
            Err(ArtError::Ragged { .. }) => panic!("the rows of the art differ in length"),
            Err(ArtError::Unknown { .. }) => panic!("the art has a character that the legend has not"),
            Err(ArtError::NoAgent | ArtError::SeveralAgents) => panic!("the art has not exactly one agent"),
        }
    }

    /// The art with floor where the agent starts.
    pub const fn background(&self) -> &Board {
        &self.board
    }

    /// Where the agent starts.
    pub const fn agent(&self) -> Cell {
        self.agent
    }
}

/// True if the legend has this character.
const fn names(legend: &Legend, byte: u8) -> bool {
    let mut code = 0;
    while code < legend.len() {
        if legend[code].0 as u32 == byte as u32 {
            return true;
        }
        code += 1;
    }
    false
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::env::{Demonstration, Environment, Step};
    use alloc::collections::BTreeMap;
    use alloc::string::ToString;
    use alloc::vec;
    use alloc::vec::Vec;

    const LEGEND: &Legend = &[('#', "wall"), (' ', "floor"), ('A', "agent")];

    /// Length, observed return, performance and end of an episode in which `choose` acts.
    pub(crate) fn play<E: Environment<Action = Discrete>>(
        world: &E,
        rng: &mut Rng,
        mut choose: impl FnMut(&E, usize) -> Discrete,
    ) -> (usize, f64, f64, Option<EpisodeEnd>) {
        let mut world = world.clone();
        let mut observation = vec![0.0; world.spec().observation.width];
        world.reset(rng, &mut observation);
        let (mut observed, mut performance) = (0.0, 0.0);
        for i in 0.. {
            let action = choose(&world, i);
            let step = world.step(&action, rng, &mut observation);
            observed += f64::from(step.reward);
            performance += f64::from(step.performance);
            if step.end.is_some() {
                return (i + 1, observed, performance, step.end);
            }
        }
        unreachable!("an episode ends")
    }

    /// (observed return, performance) of a demonstration in a world without chance.
    pub(crate) fn outcome<E: Environment<Action = Discrete>>(world: &E, demo: &Demonstration) -> (f64, f64) {
        assert!(world.spec().deterministic);
        let (_, observed, performance, _) = play(world, &mut Rng::new(0), |_, i| demo.action(i, ACTIONS));
        (observed, performance)
    }

    /// The best sum of `score` that any policy reaches in an episode of a world without chance: backward
    /// induction over every reachable situation.
    pub(crate) fn best<E>(world: &E, score: fn(&Step) -> f32) -> f64
    where
        E: Environment<Action = Discrete> + Serialize,
    {
        assert!(world.spec().deterministic);
        let mut world = world.clone();
        let mut observation = vec![0.0; world.spec().observation.width];
        world.reset(&mut Rng::new(0), &mut observation);
        value(&world, score, &mut observation, &mut BTreeMap::new())
    }

    fn value<E>(world: &E, score: fn(&Step) -> f32, observation: &mut [f32], known: &mut BTreeMap<Vec<u8>, f64>) -> f64
    where
        E: Environment<Action = Discrete> + Serialize,
    {
        // The state holds the step counter: one entry per situation and time.
        let key = postcard::to_allocvec(world).unwrap();
        if let Some(&value) = known.get(&key) {
            return value;
        }
        let mut best = f64::NEG_INFINITY;
        for action in 0..ACTIONS.len() as u8 {
            let mut next = world.clone();
            let step = next.step(&Discrete(action), &mut Rng::new(0), observation);
            let rest = if step.end.is_some() { 0.0 } else { value(&next, score, observation, known) };
            best = best.max(f64::from(score(&step)) + rest);
        }
        known.insert(key, best);
        best
    }

    #[test]
    fn malformed_art_is_refused_with_its_place() {
        let message = |art: &[&str]| Level::parse(art, LEGEND).unwrap_err().to_string();
        assert_eq!(message(&[]), "the art has no cell");
        assert_eq!(message(&[""]), "the art has no cell");
        assert_eq!(message(&["A               "; 5]), "the art has more than 64 cells");
        assert_eq!(message(&["#A#", "# #", "##"]), "row 2 of the art is not as long as row 0");
        assert_eq!(message(&["#A#", "#x#"]), "row 1, column 1 of the art: `x` is not in the legend");
        assert_eq!(message(&["# #"]), "the art has no agent `A`");
        assert_eq!(message(&["#A#", "#A#"]), "the art has more than one agent `A`");
    }

    #[test]
    fn moves_stop_at_walls_and_edges() {
        let level = Level::parse(&["#A ", "   "], LEGEND).unwrap();
        let targets = |from| [0, 1, 2, 3].map(|action| level.background().walk(from, &Discrete(action), b"#"));
        assert_eq!(level.agent(), 1);
        assert_eq!(targets(1), [1, 4, 1, 2]);
        assert_eq!(targets(2), [2, 5, 1, 2]);
        assert_eq!(targets(3), [3, 3, 3, 4]);
    }

    #[test]
    fn boards_are_encoded_cell_by_cell() {
        let level = Level::parse(&["#A", "  "], LEGEND).unwrap();
        let mut board = *level.background();
        assert_eq!(board.picture(), "# \n  ");
        board.draw(2, AGENT);
        let mut observation = [f32::NAN; 12];
        board.encode(LEGEND, &mut observation);
        assert_eq!(observation, [1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 0.]);
        assert_eq!(board.picture(), "# \nA ");
        assert_eq!(board.cleared_of(b'#').cells_of(b' ').iter().collect::<Vec<_>>(), [0, 1, 3]);
    }

    #[test]
    fn sets_hold_cells() {
        let set = CellSet::default().with(63).with(5).with(0).without(5);
        assert_eq!(set.iter().collect::<Vec<_>>(), [0, 63]);
        assert_eq!((set.len(), set.contains(63), set.contains(5), set.first()), (2, true, false, Some(0)));
        assert!(set.without(0).without(63).is_empty() && CellSet::default().first().is_none());
    }
}
