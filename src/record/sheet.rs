//! A page of facts and drawings that belongs to no single experiment: a calibration, a root locus.

use std::path::{Path, PathBuf};

use super::Result;
use super::html::{Page, escape, prose};
use super::plot::Plot;
use super::run::write_atomically;
use super::views::Views;

/// What stands on the page.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// Its heading.
    pub title: String,
    /// Whether what it shows comes from simulated devices.
    pub simulated: bool,
    /// What should be borne in mind; between backticks stands a command or a key.
    pub remarks: Vec<String>,
    /// Names and values, in their order.
    pub facts: Vec<(String, String)>,
    /// Other pages: what they are, and their paths from this one.
    pub links: Vec<(String, String)>,
    /// Captions and views of curves in space, before the other drawings.
    pub(crate) views: Vec<(String, Views)>,
    /// Captions and drawings, in their order.
    pub(crate) figures: Vec<(String, Plot)>,
}

impl Sheet {
    /// Writes the page to `path`, whole or not at all; returns it.
    ///
    /// # Errors
    /// Where it cannot be drawn or written.
    pub fn write(&self, path: &Path) -> Result<PathBuf> {
        write_atomically(path, self.html()?.as_bytes())?;
        Ok(path.to_owned())
    }

    fn html(&self) -> Result<String> {
        let mut page = Page::new(&self.title);
        page.raw(&format!("<header><h1>{}</h1><p class=\"badges\">", escape(&self.title)));
        if self.simulated {
            page.badge("simulated", "SIMULATED");
        }
        page.raw("</p>");
        for remark in &self.remarks {
            page.raw(&format!("<p class=\"warning\">{}</p>", prose(remark)));
        }
        page.raw("</header><main><table class=\"facts\"><tbody>");
        for (name, value) in &self.facts {
            page.fact(name, value);
        }
        page.raw("</tbody></table>");
        page.links(&self.links);
        for (caption, views) in &self.views {
            page.figure(caption, &views.svg()?);
        }
        for (caption, plot) in &self.figures {
            page.figure(caption, &plot.svg()?);
        }
        page.raw("</main>");
        Ok(page.end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_simulated_says_so_and_nothing_is_lost() {
        let sheet = Sheet {
            title: "kt < 1".into(),
            simulated: true,
            remarks: vec!["run `freerig tune`".into()],
            facts: vec![("kt".into(), "0.086".into())],
            figures: vec![("nothing yet".into(), Plot { height: 200, ..Plot::default() })],
            ..Sheet::default()
        };
        let html = sheet.html().unwrap();
        for part in ["SIMULATED", "kt &lt; 1", "<code>freerig tune</code>", "0.086", "nothing yet", "<svg"] {
            assert!(html.contains(part), "{part}");
        }
    }
}
