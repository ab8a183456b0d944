//! One page and one Markdown text of a whole `freerig bench`: the machine, what takes how much longer elsewhere, every
//! suite.

use std::fs;
use std::path::{Path, PathBuf};

use super::html::{Page, escape};
use super::run::write_atomically;
use super::{BenchRow, BenchSuite, Claim, RecordError, Result};

/// A run of all suites.
#[derive(Clone, Copy, Debug)]
pub struct BenchReport<'a> {
    /// Machine, versions, date, load, seeds: names and values.
    pub facts: &'a [(String, String)],
    /// What was run.
    pub suites: &'a [BenchSuite],
}

/// Heads of the comparison at equal error.
const HEADS: [&str; 6] = ["task", "both within", "freerig", "peer", "time", "times as long"];

impl BenchReport<'_> {
    /// Writes bench.html and bench.md into `directory`; returns the page's path.
    ///
    /// # Errors
    /// Where one of them cannot be drawn or written.
    pub fn write(&self, directory: &Path) -> Result<PathBuf> {
        fs::create_dir_all(directory).map_err(|source| RecordError::Io { path: directory.to_owned(), source })?;
        write_atomically(&directory.join("bench.md"), self.markdown().as_bytes())?;
        let page = directory.join("bench.html");
        write_atomically(&page, self.html()?.as_bytes())?;
        Ok(page)
    }

    fn claims(&self) -> impl Iterator<Item = [String; 6]> {
        self.suites.iter().flat_map(|suite| &suite.claims).map(cells)
    }

    /// What is not there: peers that are not installed.
    fn missing(&self) -> impl Iterator<Item = &BenchRow> {
        self.suites.iter().flat_map(|suite| &suite.rows).filter(|row| row.case.contains("not run: "))
    }

    /// What the README shows: facts, times at equal error, and the facts of every suite.
    fn markdown(&self) -> String {
        let list = |facts: &[(String, String)]| -> String {
            facts.iter().map(|(name, value)| format!("- {name}: {value}\n")).collect()
        };
        let mut text = list(self.facts);
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        text += "\n";
        text += &line(&HEADS.map(String::from));
        text += "| --- | --: | --- | --- | --: | --: |\n";
        text.extend(self.claims().map(|cells| line(&cells)));
        text += "\n";
        text.extend(self.missing().map(|row| format!("- {}: {}\n", row.method, row.case)));
        for suite in self.suites {
            text += &format!("\n**{}**\n\n{}", suite.title, list(&suite.facts));
        }
        text
    }

    fn html(&self) -> Result<String> {
        let mut page = Page::new("freerig bench");
        page.raw("<header><h1>Speed against error</h1><p class=\"badges\">");
        page.badge("simulated", "SIMULATED");
        page.raw("</p></header><main>");
        facts(&mut page, self.facts);
        page.raw("<h2>At equal error</h2>");
        table(&mut page, &HEADS, self.claims());
        for row in self.missing() {
            page.raw(&format!("<p class=\"note\">{}: {}</p>", escape(&row.method), escape(&row.case)));
        }
        for suite in self.suites {
            page.raw(&format!("<h2>{}</h2>", escape(suite.title)));
            facts(&mut page, &suite.facts);
            page.figure(suite.caption, &suite.plot().svg()?);
            page.raw(&format!("<details><summary>{} rows</summary>", suite.rows.len()));
            table(&mut page, &["method", "case", "relative error", "time", ""], suite.rows.iter().map(row));
            page.raw("</details>");
        }
        page.raw("</main>");
        Ok(page.end())
    }
}

fn facts(page: &mut Page, facts: &[(String, String)]) {
    page.raw("<table class=\"facts\"><tbody>");
    for (name, value) in facts {
        page.fact(name, value);
    }
    page.raw("</tbody></table>");
}

fn table<const N: usize>(page: &mut Page, heads: &[&str; N], rows: impl Iterator<Item = [String; N]>) {
    let cells = |tag: &str, cells: &[String]| -> String {
        cells.iter().map(|cell| format!("<{tag} class=\"text\">{}</{tag}>", escape(cell))).collect()
    };
    page.raw(&format!("<table><thead><tr>{}</tr></thead><tbody>", cells("th", &heads.map(String::from))));
    for row in rows {
        page.raw(&format!("<tr>{}</tr>", cells("td", &row)));
    }
    page.raw("</tbody></table>");
}

fn cells(claim: &Claim) -> [String; 6] {
    let who = |who: &str| who.strip_prefix("freerig, ").unwrap_or(who).to_owned();
    let Claim { own, peer, .. } = claim;
    [
        claim.task.clone(),
        percent(claim.error),
        format!("{}: {}", who(&own.who), percent(own.error)),
        format!("{}: {}", peer.who, percent(peer.error)),
        format!("{} against {}", time(own.time_s), time(peer.time_s)),
        format!("{:.*}", usize::from(claim.ratio() < 10.0), claim.ratio()),
    ]
}

/// A comparison in words.
pub(super) fn fact(claim: &Claim) -> (String, String) {
    let [task, error, own, peer, times, ratio] = cells(claim);
    (format!("{task}, both within {error}"), format!("freerig {own}; {peer}; {times}: {ratio} times"))
}

fn row(row: &BenchRow) -> [String; 5] {
    let of = |value: Option<f64>, show: fn(f64) -> String| value.map_or(String::new(), show);
    let failed = if row.failed { "FAILED" } else { "" };
    let error = of(row.relative_error, |error| format!("{error:.2e}"));
    [row.method.clone(), row.case.clone(), error, of(row.time_s, time), failed.into()]
}

/// A relative error in percent to two digits; the small ones as powers of ten.
fn percent(error: f64) -> String {
    match 100.0 * error {
        percent if percent >= 1e-3 => format!("{} %", (percent * 1e4).round() / 1e4),
        _ => format!("{error:.1e}"),
    }
}

/// A time (s) in the unit that suits it.
fn time(seconds: f64) -> String {
    match seconds {
        s if s < 1e-3 => format!("{:.3} us", 1e6 * s),
        s if s < 1.0 => format!("{:.3} ms", 1e3 * s),
        s => format!("{s:.2} s"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Timed;
    use super::*;

    #[test]
    fn the_page_and_the_text_say_machine_claims_and_who_is_missing() {
        let timed = |who: &str, error, time_s| Timed { who: who.into(), error, time_s };
        let claim = Claim {
            task: "R1".into(),
            error: 1e-3,
            own: timed("freerig, degree 2", 5e-4, 2e-5),
            peer: timed("Exudyn 1.13.6, 8 elements", 9.3e-4, 4e-3),
        };
        let missing = BenchRow {
            suite: "rods",
            method: "scipy".into(),
            case: "not run: scipy not found; `pip install scipy`".into(),
            relative_error: None,
            time_s: None,
            failed: false,
        };
        let suite = BenchSuite { title: "Rods", claims: vec![claim], rows: vec![missing], ..BenchSuite::default() };
        let facts = [("cores".to_owned(), "2".to_owned())];
        let report = BenchReport { facts: &facts, suites: &[suite] };
        let line =
            "| R1 | 0.1 % | degree 2: 0.05 % | Exudyn 1.13.6, 8 elements: 0.093 % | 20.000 us against 4.000 ms | 200 |";
        assert!(report.markdown().contains(line), "{}", report.markdown());
        for text in [report.markdown(), report.html().unwrap()] {
            for part in ["cores", "20.000 us against 4.000 ms", "pip install scipy", "Rods"] {
                assert!(text.contains(part), "{part} in {text}");
            }
        }
    }
}
