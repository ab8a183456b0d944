//! Reads one TOML file key by key, and notes everything that is wrong with it instead of stopping at the first.
//!
//! A value that is wrong is replaced by its default (or by a stand-in where it has none), so that reading goes on
//! to the next problem; the stand-ins never leave this floor, because nothing is built from a file with problems.
//! The keys that were asked for are the keys that exist: whatever else a table holds is an unknown key.

use std::cell::RefCell;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::key;
use super::problem::Problem;

/// Longest excerpt of the file in a problem.
const EXCERPT: usize = 60;

/// A file's text with what has been found wrong with it.
#[derive(Debug)]
pub(super) struct Source<'a> {
    file: &'a Path,
    text: &'a str,
    problems: RefCell<Vec<Problem>>,
}

impl<'a> Source<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        Self { file, text, problems: RefCell::default() }
    }

    /// The document; syntax errors are noted, and leave nothing worth reading on.
    pub(super) fn parse(&self) -> Option<DeTable<'a>> {
        let table = self.parse_as_far_as_possible();
        self.problems.borrow().is_empty().then_some(table)
    }

    /// The document, or what is left of it behind its syntax errors, which are noted.
    pub(super) fn parse_as_far_as_possible(&self) -> DeTable<'a> {
        let (table, errors) = DeTable::parse_recoverable(self.text);
        for error in errors {
            let span = error.span();
            self.problems.borrow_mut().push(Problem {
                file: self.file.to_owned(),
                line: span.clone().map(|span| self.line(span.start)),
                key: String::new(),
                value: span.map(|span| self.excerpt(span)).unwrap_or_default(),
                rule: format!("not TOML: {}", error.message()),
                remedy: "correct the syntax; the other keys are checked once the file can be read".into(),
            });
        }
        table.into_inner()
    }

    /// The problems found, in the order of the lines.
    pub(super) fn into_problems(self) -> Vec<Problem> {
        let mut problems = self.problems.into_inner();
        problems.sort_by_key(|problem| problem.line);
        problems
    }

    fn line(&self, offset: usize) -> usize {
        1 + self.text.as_bytes().iter().take(offset).filter(|&&byte| byte == b'\n').count()
    }

    fn excerpt(&self, span: std::ops::Range<usize>) -> String {
        let text = self.text.get(span).unwrap_or_default();
        let line = text.lines().next().unwrap_or_default();
        match line.char_indices().nth(EXCERPT) {
            Some((end, _)) => format!("{} ...", &line[..end]),
            None if line.len() < text.trim_end().len() => format!("{line} ..."),
            None => line.to_owned(),
        }
    }
}

/// One table of the file. Unknown keys are noted when it is dropped.
#[derive(Debug)]
pub(super) struct Section<'a> {
    source: &'a Source<'a>,
    path: String,
    /// `None` for a table that is not there: every key has its default.
    table: Option<&'a DeTable<'a>>,
    line: Option<usize>,
    asked: Vec<&'a str>,
}

impl<'a> Section<'a> {
    /// The document's own table.
    pub(super) fn root(source: &'a Source<'a>, table: &'a DeTable<'a>) -> Self {
        Self { source, path: String::new(), table: Some(table), line: None, asked: Vec::new() }
    }

    /// Whether the table stands in the file.
    pub(super) fn is_present(&self) -> bool {
        self.table.is_some()
    }

    /// Whether `key` stands in the table.
    pub(super) fn has(&self, key: &str) -> bool {
        self.table.is_some_and(|table| table.get(key).is_some())
    }

    /// Calls the table `name` from here on, in place of its position in an array.
    pub(super) fn rename(&mut self, path: String) {
        self.path = path;
    }

    /// A number in the unit of the key's name, within `range` of that unit; the answer is in SI. Without a
    /// `default` the key is required.
    pub(super) fn number(
        &mut self,
        key: &'static str,
        default: impl Into<Option<f64>>,
        range: RangeInclusive<f64>,
    ) -> f64 {
        let scale = key::scale(key);
        match self.optional_number(key, range.clone()) {
            Some(value) => value,
            None => match default.into() {
                Some(default) => default * scale,
                None => {
                    // What is there and wrong has been told.
                    if !self.has(key) {
                        self.require(key, &in_range(&range));
                    }
                    f64::NAN
                }
            },
        }
    }

    /// Like [`Section::number`], `None` where the key is absent (or wrong, which is noted).
    pub(super) fn optional_number(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Option<f64> {
        let value = self.get(key)?;
        match number(value.get_ref()) {
            Some(number) if range.contains(&number) => Some(number * key::scale(key)),
            Some(_) => {
                let range = in_range(&range);
                self.reject(key, format!("must be {range}"), format!("write a value {range}"));
                None
            }
            None => {
                self.reject(key, "must be a number", format!("write `{key} = ` and a number {}", in_range(&range)));
                None
            }
        }
    }

    /// A whole number within `range`.
    pub(super) fn integer(
        &mut self,
        key: &'static str,
        default: impl Into<Option<i64>>,
        range: RangeInclusive<i64>,
    ) -> i64 {
        let rule = format!("a whole number within {} to {}", range.start(), range.end());
        self.whole(key, default.into(), range, &rule)
    }

    /// A chip's I2C address within `range`, which data sheets write as hexadecimals.
    pub(super) fn address(&mut self, default: i64, range: RangeInclusive<i64>) -> u8 {
        let rule = format!("an address from {:#04x} to {:#04x}", range.start(), range.end());
        self.whole("address", Some(default), range, &rule) as u8
    }

    fn whole(&mut self, key: &'static str, default: Option<i64>, range: RangeInclusive<i64>, rule: &str) -> i64 {
        match self.get(key).map(|value| integer(value.get_ref())) {
            Some(Some(value)) if range.contains(&value) => value,
            Some(_) => {
                self.reject(key, format!("must be {rule}"), format!("write {rule}"));
                *range.start()
            }
            None => default.unwrap_or_else(|| {
                self.require(key, rule);
                *range.start()
            }),
        }
    }

    /// `true` or `false`.
    pub(super) fn flag(&mut self, key: &'static str, default: bool) -> bool {
        match self.get(key).map(Spanned::get_ref) {
            Some(DeValue::Boolean(value)) => *value,
            Some(_) => {
                self.reject(key, "must be true or false", format!("write `{key} = true` or `{key} = false`"));
                default
            }
            None => default,
        }
    }

    /// A text, `None` where the key is absent (or wrong, which is noted).
    pub(super) fn optional_text(&mut self, key: &'static str) -> Option<String> {
        self.optional_lines(key).filter(|text| {
            let one = !text.contains(['\n', '\t']);
            if !one {
                self.reject(key, "must be one line without control characters", "write plain text");
            }
            one
        })
    }

    /// A text of one or more lines. Nothing that moves a terminal's cursor is a text.
    pub(super) fn optional_lines(&mut self, key: &'static str) -> Option<String> {
        match self.get(key)?.get_ref() {
            DeValue::String(text) if is_plain(text) => Some(text.to_string()),
            DeValue::String(_) => {
                self.reject(key, "must not contain control characters", "write plain text");
                None
            }
            _ => {
                self.reject(key, "must be a text", format!("write it in quotes: `{key} = \"...\"`"));
                None
            }
        }
    }

    /// A text that must be there; `example` shows what is meant.
    pub(super) fn text(&mut self, key: &'static str, example: &str) -> String {
        if !self.has(key) {
            self.require(key, &format!("a text, for example \"{example}\""));
        }
        self.optional_text(key).unwrap_or_default()
    }

    /// A path.
    pub(super) fn path(&mut self, key: &'static str, default: &str) -> PathBuf {
        self.optional_text(key).map_or_else(|| PathBuf::from(default), PathBuf::from)
    }

    /// One of several words; without a `default` the key is required.
    pub(super) fn choice<T: Copy>(
        &mut self,
        key: &'static str,
        default: Option<T>,
        choices: &[(&str, T)],
    ) -> Option<T> {
        let words = choices.iter().map(|choice| format!("\"{}\"", choice.0)).collect::<Vec<_>>().join(", ");
        if !self.has(key) {
            if default.is_none() {
                self.require(key, &format!("one of {words}"));
            }
            return default;
        }
        let text = self.optional_text(key)?;
        match choices.iter().find(|choice| choice.0 == text) {
            Some(choice) => Some(choice.1),
            None => {
                self.reject(key, format!("must be one of {words}"), format!("write one of {words}"));
                default
            }
        }
    }

    /// Numbers in the unit of the key's name, `None` where the key is absent (or wrong, which is noted). In SI.
    pub(super) fn numbers(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Option<Vec<f64>> {
        let value = self.get(key)?;
        let scale = key::scale(key);
        let numbers: Option<Vec<f64>> = array(value.get_ref())
            .and_then(|array| array.iter().map(|item| number(item.get_ref()).filter(|n| range.contains(n))).collect());
        if numbers.is_none() {
            let rule = format!("must be a list of numbers, each {}", in_range(&range));
            self.reject(key, rule, format!("write for example `{key} = [1, 2]`"));
        }
        Some(numbers?.into_iter().map(|number| number * scale).collect())
    }

    /// Lists of numbers in the unit of the key's name; none where the key is absent (or wrong, which is noted). In SI.
    pub(super) fn rows(&mut self, key: &'static str, range: RangeInclusive<f64>) -> Vec<Vec<f64>> {
        let Some(value) = self.get(key) else { return Vec::new() };
        let scale = key::scale(key);
        let row = |item: &Spanned<DeValue<'_>>| -> Option<Vec<f64>> {
            let item = array(item.get_ref())?.iter();
            item.map(|item| number(item.get_ref()).filter(|n| range.contains(n)).map(|n| n * scale)).collect()
        };
        let rows = array(value.get_ref()).and_then(|array| array.iter().map(row).collect());
        rows.unwrap_or_else(|| {
            let rule = format!("must be a list of lists of numbers, each {}", in_range(&range));
            self.reject(key, rule, format!("write for example `{key} = [[1, 2, 3], [4, 5, 6]]`"));
            Vec::new()
        })
    }

    /// Texts; none where the key is absent (or wrong, which is noted).
    pub(super) fn texts(&mut self, key: &'static str) -> Vec<String> {
        let Some(value) = self.get(key) else { return Vec::new() };
        let text = |item: &DeValue<'_>| match item {
            DeValue::String(text) => Some(text.to_string()),
            _ => None,
        };
        let texts = array(value.get_ref()).and_then(|array| array.iter().map(|item| text(item.get_ref())).collect());
        texts.unwrap_or_else(|| {
            self.reject(key, "must be a list of texts", format!("write for example `{key} = [\"a\"]`"));
            Vec::new()
        })
    }

    /// Lowest and highest value, in the unit of the key's name; the answer is in SI.
    pub(super) fn span(&mut self, key: &'static str, default: (f64, f64), range: RangeInclusive<f64>) -> (f64, f64) {
        let scale = key::scale(key);
        match self.numbers(key, range).as_deref() {
            None => (default.0 * scale, default.1 * scale),
            Some(&[low, high]) if low < high => (low, high),
            Some(_) => {
                self.reject(
                    key,
                    "must be two numbers, the lower one first",
                    format!("write for example `{key} = [-1, 1]`"),
                );
                (default.0 * scale, default.1 * scale)
            }
        }
    }

    /// The table `key`; an absent one reads as empty.
    pub(super) fn section(&mut self, key: &'static str) -> Section<'a> {
        let found = self.get(key);
        let table = match found.map(|value| value.get_ref()) {
            Some(DeValue::Table(table)) => Some(table),
            Some(_) => {
                self.reject(key, "must be a table", format!("write `[{}]` on a line of its own", self.full(key)));
                None
            }
            None => None,
        };
        Section {
            source: self.source,
            path: self.full(key),
            table,
            line: found.map(|value| self.source.line(value.span().start)).or(self.line),
            asked: Vec::new(),
        }
    }

    /// The tables of the array `[[key]]`.
    pub(super) fn sections(&mut self, key: &'static str) -> Vec<Section<'a>> {
        let Some(value) = self.get(key) else { return Vec::new() };
        let tables: Option<Vec<_>> = array(value.get_ref()).and_then(|array| {
            array
                .iter()
                .enumerate()
                .map(|(index, item)| match item.get_ref() {
                    DeValue::Table(table) => Some(Section {
                        source: self.source,
                        path: format!("{}[{index}]", self.full(key)),
                        table: Some(table),
                        line: Some(self.source.line(item.span().start)),
                        asked: Vec::new(),
                    }),
                    _ => None,
                })
                .collect()
        });
        if tables.is_none() {
            let full = self.full(key);
            self.reject(key, "must be a list of tables", format!("write `[[{full}]]` before each of them"));
        }
        tables.unwrap_or_default()
    }

    /// The tables inside the table `key`, by their names.
    pub(super) fn named(&mut self, key: &'static str) -> Vec<(String, Section<'a>)> {
        let mut outer = self.section(key);
        let Some(table) = outer.table else { return Vec::new() };
        let mut named = Vec::new();
        for (name, value) in table.iter() {
            outer.asked.push(name.get_ref());
            let path = format!("{}.{}", outer.path, name.get_ref());
            match value.get_ref() {
                DeValue::Table(table) => named.push((
                    name.get_ref().to_string(),
                    Section {
                        source: self.source,
                        path,
                        table: Some(table),
                        line: Some(self.source.line(value.span().start)),
                        asked: Vec::new(),
                    },
                )),
                _ => outer.note(
                    path.clone(),
                    Some(value),
                    "must be a table".into(),
                    format!("write `[{path}]` on a line of its own"),
                ),
            }
        }
        named
    }

    /// Notes that the value of `key` breaks `rule`; `remedy` says what to do.
    pub(super) fn reject(&self, key: &str, rule: impl Into<String>, remedy: impl Into<String>) {
        self.note(self.full(key), self.table.and_then(|table| table.get(key)), rule.into(), remedy.into());
    }

    /// Notes that `key`, which is `what`, is required and not there.
    pub(super) fn require(&mut self, key: &'static str, what: &str) {
        self.expect(key);
        self.note(self.full(key), None, format!("is required: {what}"), format!("add `{key} = ...`: {what}"));
    }

    /// `key` is known, whether or not it stands in the table.
    pub(super) fn expect(&mut self, key: &'static str) {
        if !self.asked.contains(&key) {
            self.asked.push(key);
        }
    }

    fn note(&self, key: String, value: Option<&Spanned<DeValue<'_>>>, rule: String, remedy: String) {
        let problem = Problem {
            file: self.source.file.to_owned(),
            line: value.map(|value| self.source.line(value.span().start)).or(self.line),
            key,
            value: value.map(|value| self.source.excerpt(value.span())).unwrap_or_default(),
            rule,
            remedy,
        };
        self.source.problems.borrow_mut().push(problem);
    }

    fn get(&mut self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.expect(key);
        self.table.and_then(|table| table.get(key))
    }

    /// Takes whatever else the table holds as known.
    pub(super) fn accept_rest(&mut self) {
        self.asked.extend(self.table.into_iter().flat_map(|table| table.keys()).map(|name| &**name.get_ref()));
    }

    /// The key with the names of the tables around it.
    pub(super) fn full(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }
}

impl Drop for Section<'_> {
    fn drop(&mut self) {
        for (name, value) in self.table.into_iter().flat_map(|table| table.iter()) {
            let name = name.get_ref();
            if !self.asked.iter().any(|asked| asked == name) {
                let remedy = key::suggestion(name, number(value.get_ref()), &self.asked);
                self.note(self.full(name), Some(value), "unknown key".into(), remedy);
            }
        }
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok().filter(|value: &f64| value.is_finite()),
        DeValue::Integer(_) => integer(value).map(|value| value as f64),
        _ => None,
    }
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    match value {
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix()).ok(),
        _ => None,
    }
}

fn array<'v, 'a>(value: &'v DeValue<'a>) -> Option<&'v DeArray<'a>> {
    match value {
        DeValue::Array(array) => Some(array),
        _ => None,
    }
}

fn in_range(range: &RangeInclusive<f64>) -> String {
    match (range.start().is_finite(), range.end().is_finite()) {
        (true, true) => format!("within {} to {}", range.start(), range.end()),
        (true, false) => format!("at least {}", range.start()),
        (false, true) => format!("at most {}", range.end()),
        (false, false) => "finite".into(),
    }
}

/// Whether `text` can be shown as it is: lines and tabs are all that controls anything in it.
pub fn is_plain(text: &str) -> bool {
    text.chars().all(|c| !c.is_control() || matches!(c, '\n' | '\t'))
}
