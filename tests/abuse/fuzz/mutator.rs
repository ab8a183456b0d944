//! Mutations of seeds: of bits and bytes, of lines, of numbers, with words of the language in question.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Numbers at which something often ends.
const NUMBERS: [&str; 20] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "0.5",
    "1e-300",
    "1e300",
    "-1e300",
    "1e999",
    "nan",
    "-inf",
    "inf",
    "255",
    "256",
    "65536",
    "2147483648",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "1_000",
];

/// Makes cases out of seeds.
pub struct Mutator<'a> {
    random: Pcg64Mcg,
    seeds: Vec<Vec<u8>>,
    words: &'a [&'a str],
}

impl<'a> Mutator<'a> {
    pub fn new(seeds: Vec<Vec<u8>>, words: &'a [&'a str]) -> Self {
        assert!(!seeds.is_empty());
        Self { random: Pcg64Mcg::seed_from_u64(1), seeds, words }
    }

    pub fn next(&mut self) -> Vec<u8> {
        let mut case = self.seed().to_vec();
        // Mostly little, so that much of it is accepted.
        let steps = 1 + self.random.random_range(0..4u32) * self.random.random_range(0..2u32);
        for _ in 0..steps {
            self.step(&mut case);
        }
        case
    }

    fn seed(&mut self) -> &[u8] {
        let index = self.random.random_range(0..self.seeds.len());
        &self.seeds[index]
    }

    /// A place in `case`, its end included.
    fn place(&mut self, case: &[u8]) -> usize {
        self.random.random_range(0..=case.len())
    }

    /// Two places in order, not far from each other.
    fn span(&mut self, case: &[u8]) -> (usize, usize) {
        let from = self.place(case);
        (from, (from + self.random.random_range(0..64)).min(case.len()))
    }

    fn step(&mut self, case: &mut Vec<u8>) {
        match self.random.random_range(0..14) {
            0 if !case.is_empty() => {
                let at = self.random.random_range(0..case.len());
                case[at] ^= 1 << self.random.random_range(0..8);
            }
            1 => {
                let at = self.place(case);
                case.insert(at, self.random.random());
            }
            2 => {
                let (from, to) = self.span(case);
                case.drain(from..to);
            }
            3 => {
                let (from, to) = self.span(case);
                let (at, piece) = (self.place(case), case[from..to].to_vec());
                case.splice(at..at, piece);
            }
            4 => case.truncate(self.place(case)),
            5..=8 => self.number(case),
            9 | 10 => {
                let word = self.words[self.random.random_range(0..self.words.len())];
                let at = self.place(case);
                case.splice(at..at, word.bytes());
            }
            11 => self.lines(case),
            12 => {
                // A line of another seed.
                let other = self.seed().to_vec();
                let lines: Vec<&[u8]> = other.split_inclusive(|&b| b == b'\n').collect();
                if !lines.is_empty() {
                    let line = lines[self.random.random_range(0..lines.len())];
                    let at = self.line_start(case);
                    case.splice(at..at, line.iter().copied());
                }
            }
            _ => {
                let bracket = [b'[', b'{', b'"', b'\'', b'#', b'.'][self.random.random_range(0..6)];
                let times = 1 << self.random.random_range(0..13);
                let at = self.place(case);
                case.splice(at..at, std::iter::repeat_n(bracket, times));
            }
        }
    }

    /// Another number in the place of one.
    fn number(&mut self, case: &mut Vec<u8>) {
        let is = |b: u8| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+');
        let starts: Vec<usize> =
            (0..case.len()).filter(|&i| case[i].is_ascii_digit() && (i == 0 || !is(case[i - 1]))).collect();
        if starts.is_empty() {
            return;
        }
        let from = starts[self.random.random_range(0..starts.len())];
        let to = (from..case.len()).find(|&i| !is(case[i])).unwrap_or(case.len());
        let old: Option<f64> = std::str::from_utf8(&case[from..to]).ok().and_then(|text| text.parse().ok());
        let new = match (self.random.random_range(0..3), old) {
            (0, Some(old)) => format!("{}", old * self.random.random_range(0.5..2.0)),
            (1, Some(old)) => format!("{}", old + f64::from(self.random.random_range(-2..=2))),
            _ => NUMBERS[self.random.random_range(0..NUMBERS.len())].to_owned(),
        };
        case.splice(from..to, new.bytes());
    }

    /// The start of a line.
    fn line_start(&mut self, case: &[u8]) -> usize {
        let at = self.place(case);
        case[..at].iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1)
    }

    /// A line twice, or not at all, or somewhere else.
    fn lines(&mut self, case: &mut Vec<u8>) {
        let from = self.line_start(case);
        let to = case[from..].iter().position(|&b| b == b'\n').map_or(case.len(), |end| from + end + 1);
        let line = case[from..to].to_vec();
        let kind = self.random.random_range(0..3);
        if kind > 0 {
            case.drain(from..to);
        }
        if kind < 2 {
            let at = self.line_start(case);
            case.splice(at..at, line);
        }
    }
}
