//! From text to a condition that is known to be well formed.

use std::fmt;

use super::metric::{self, Source};
use super::{Comparison, Condition, Number, NumberKind, Problem};

/// Parses a whole expression.
pub(super) fn condition(text: &str) -> Result<Condition, Problem> {
    let end = text.trim_end().chars().count();
    Parser { tokens: tokens(text)?, next: 0, end, in_fraction: false }.whole()
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Number(f64),
    Word(String),
    Symbol(&'static str),
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Token::Number(number) => write!(f, "`{number}`"),
            Token::Word(word) => write!(f, "`{word}`"),
            Token::Symbol(symbol) => write!(f, "`{symbol}`"),
        }
    }
}

/// Most words, numbers and symbols: each can nest the rest once more, and nesting takes stack.
const MAX_TOKENS: usize = 300;

/// Longer symbols first, so that `<=` is not read as `<`.
const SYMBOLS: &[&str] = &["<=", ">=", "==", "!=", "<", ">", "+", "-", "*", "/", "(", ")"];

fn tokens(text: &str) -> Result<Vec<(usize, Token)>, Problem> {
    let characters: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut at = 0;
    while at < characters.len() {
        let start = at;
        let first = characters[at];
        let mut take = |allowed: fn(char) -> bool| {
            let length = characters[start..].iter().take_while(|c| allowed(**c)).count();
            at = start + length;
            characters[start..at].iter().collect::<String>()
        };
        if first.is_whitespace() {
            at += 1;
        } else if first.is_ascii_digit() || first == '.' {
            at = start + number_length(&characters[start..]);
            let word: String = characters[start..at].iter().collect();
            let number = word.parse().map_err(|_| Problem(start, format!("`{word}` is not a number")))?;
            tokens.push((start, Token::Number(number)));
        } else if first.is_alphabetic() {
            tokens.push((start, Token::Word(take(|c| c.is_alphanumeric() || c == '.' || c == '_'))));
        } else {
            let rest: String = characters[at..].iter().take(2).collect();
            let Some(symbol) = SYMBOLS.iter().find(|symbol| rest.starts_with(**symbol)) else {
                let hint = if first == '=' { "; equality is `==`" } else { "" };
                return Err(Problem(start, format!("unexpected `{first}`{hint}")));
            };
            at += symbol.len();
            tokens.push((start, Token::Symbol(symbol)));
        }
        if tokens.len() > MAX_TOKENS {
            return Err(Problem(start, format!("too long: at most {MAX_TOKENS} words, numbers and symbols")));
        }
    }
    Ok(tokens)
}

/// How many characters belong to the number at the beginning of a text: `45`, `.5`, `1e-9`.
fn number_length(text: &[char]) -> usize {
    let digits = |from: usize| text[from..].iter().take_while(|c| c.is_ascii_digit()).count();
    let plain = text.iter().take_while(|c| c.is_ascii_digit() || **c == '.').count();
    let mut exponent = text[plain..].iter().copied();
    if !exponent.next().is_some_and(|c| c == 'e' || c == 'E') {
        return plain;
    }
    let sign = usize::from(exponent.next().is_some_and(|c| c == '+' || c == '-'));
    match digits(plain + 1 + sign) {
        0 => plain,
        count => plain + 1 + sign + count,
    }
}

/// What a parenthesis may turn out to hold.
enum Value {
    Number(Number),
    Condition(usize, Condition),
}

impl Value {
    fn number(self) -> Result<Number, Problem> {
        match self {
            Value::Number(number) => Ok(number),
            Value::Condition(position, _) => {
                Err(Problem(position, "a number is needed here, this is a condition".into()))
            }
        }
    }

    fn condition(self) -> Result<Condition, Problem> {
        match self {
            Value::Condition(_, condition) => Ok(condition),
            Value::Number(number) => Err(Problem(
                number.position,
                "this is a number; a condition compares, for example `mc.return >= 45`".into(),
            )),
        }
    }
}

struct Parser {
    tokens: Vec<(usize, Token)>,
    next: usize,
    end: usize,
    in_fraction: bool,
}

impl Parser {
    fn whole(&mut self) -> Result<Condition, Problem> {
        let value = self.either()?;
        match self.tokens.get(self.next) {
            None => value.condition(),
            Some((position, token)) => Err(Problem(*position, format!("unexpected {token}"))),
        }
    }

    fn position(&self) -> usize {
        self.tokens.get(self.next).map_or(self.end, |(position, _)| *position)
    }

    /// Consumes the next token if it is one of these words or symbols.
    fn accept(&mut self, wanted: &[&'static str]) -> Option<&'static str> {
        let (_, token) = self.tokens.get(self.next)?;
        let matches = |text: &&'static str| match token {
            Token::Word(word) => word == *text,
            Token::Symbol(symbol) => *symbol == *text,
            Token::Number(_) => false,
        };
        let found = wanted.iter().copied().find(matches)?;
        self.next += 1;
        Some(found)
    }

    fn expect(&mut self, symbol: &'static str) -> Result<(), Problem> {
        let position = self.position();
        self.accept(&[symbol]).map(|_| ()).ok_or_else(|| Problem(position, format!("`{symbol}` is missing here")))
    }

    fn either(&mut self) -> Result<Value, Problem> {
        let start = self.position();
        let mut left = self.both()?;
        while self.accept(&["or"]).is_some() {
            let right = self.both()?.condition()?;
            left = Value::Condition(start, Condition::Or(Box::new(left.condition()?), Box::new(right)));
        }
        Ok(left)
    }

    fn both(&mut self) -> Result<Value, Problem> {
        let start = self.position();
        let mut left = self.negation()?;
        while self.accept(&["and"]).is_some() {
            let right = self.negation()?.condition()?;
            left = Value::Condition(start, Condition::And(Box::new(left.condition()?), Box::new(right)));
        }
        Ok(left)
    }

    fn negation(&mut self) -> Result<Value, Problem> {
        let start = self.position();
        if self.accept(&["not"]).is_some() {
            let inner = self.negation()?.condition()?;
            return Ok(Value::Condition(start, Condition::Not(Box::new(inner))));
        }
        self.comparison()
    }

    fn comparison(&mut self) -> Result<Value, Problem> {
        let start = self.position();
        let left = self.sum()?;
        let Some(symbol) = self.accept(&["<=", ">=", "==", "!=", "<", ">"]) else { return Ok(left) };
        let comparison = match symbol {
            "<=" => Comparison::LessEqual,
            ">=" => Comparison::GreaterEqual,
            "==" => Comparison::Equal,
            "!=" => Comparison::NotEqual,
            "<" => Comparison::Less,
            _ => Comparison::Greater,
        };
        let right = self.sum()?.number()?;
        Ok(Value::Condition(start, Condition::Compare(comparison, Box::new(left.number()?), Box::new(right))))
    }

    fn sum(&mut self) -> Result<Value, Problem> {
        self.operation(&["+", "-"], Self::product)
    }

    fn product(&mut self) -> Result<Value, Problem> {
        self.operation(&["*", "/"], Self::unary)
    }

    fn operation(
        &mut self,
        symbols: &[&'static str],
        operand: fn(&mut Self) -> Result<Value, Problem>,
    ) -> Result<Value, Problem> {
        let mut left = operand(self)?;
        let mut position = self.position();
        while let Some(symbol) = self.accept(symbols) {
            let right = operand(self)?.number()?;
            let kind = NumberKind::Operate(symbol, Box::new(left.number()?), Box::new(right));
            left = Value::Number(Number { position, kind });
            position = self.position();
        }
        Ok(left)
    }

    fn unary(&mut self) -> Result<Value, Problem> {
        let position = self.position();
        if self.accept(&["-"]).is_some() {
            let inner = self.unary()?.number()?;
            return Ok(Value::Number(Number { position, kind: NumberKind::Negate(Box::new(inner)) }));
        }
        self.primary()
    }

    fn primary(&mut self) -> Result<Value, Problem> {
        let position = self.position();
        if self.accept(&["("]).is_some() {
            let inner = self.either()?;
            self.expect(")")?;
            return Ok(inner);
        }
        if self.accept(&["fraction"]).is_some() {
            return self.fraction(position);
        }
        let kind = match self.tokens.get(self.next).map(|(_, token)| token.clone()) {
            Some(Token::Number(number)) => NumberKind::Literal(number),
            Some(Token::Word(word)) => self.metric(&word)?,
            Some(token) => return Err(Problem(position, format!("a number or a metric is needed here, not {token}"))),
            None => return Err(Problem(position, "the expression ends here: a number or a metric is missing".into())),
        };
        self.next += 1;
        Ok(Value::Number(Number { position, kind }))
    }

    fn fraction(&mut self, position: usize) -> Result<Value, Problem> {
        if self.in_fraction {
            return Err(Problem(position, "`fraction` cannot stand inside `fraction`".into()));
        }
        self.in_fraction = true;
        self.expect("(")?;
        let condition = self.either()?.condition()?;
        self.expect(")")?;
        self.in_fraction = false;
        Ok(Value::Number(Number { position, kind: NumberKind::Fraction(Box::new(condition)) }))
    }

    fn metric(&self, word: &str) -> Result<NumberKind, Problem> {
        let position = self.position();
        let Some((arm, metric)) = metric::find(word) else { return Err(Problem(position, metric::unknown(word))) };
        if self.in_fraction && matches!(metric.source, Source::Return(_) | Source::Performance(_)) {
            return Err(Problem(
                position,
                format!("`{word}` is about all seeds together: it has no place in `fraction`"),
            ));
        }
        Ok(NumberKind::Metric(arm, metric))
    }
}
