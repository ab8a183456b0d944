//! The page that reports and comparisons are written on: self-contained, no script.

use std::fmt::Write;

const STYLE: &str = include_str!("report.css");

/// A page as it is written.
pub(super) struct Page(String);

impl Page {
    /// A page called `title`, up to its body.
    pub(super) fn new(title: &str) -> Self {
        let mut page = Self(String::new());
        page.raw("<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">");
        page.raw("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">");
        page.raw(&format!("<title>{} - freerig</title><style>{STYLE}</style></head><body>", escape(title)));
        page
    }

    /// The whole page.
    pub(super) fn end(mut self) -> String {
        self.raw("</body></html>");
        self.0
    }

    /// Appends `html` as it is.
    pub(super) fn raw(&mut self, html: &str) {
        self.0.push_str(html);
        self.0.push('\n');
    }

    /// A label of class `class`.
    pub(super) fn badge(&mut self, class: &str, text: &str) {
        let _ = writeln!(self.0, "<span class=\"badge {class}\">{}</span>", escape(text));
    }

    /// A figure with its name; `value` is HTML.
    pub(super) fn card(&mut self, name: &str, value: &str) {
        let _ = writeln!(self.0, "<div class=\"card\"><span>{}</span><b>{value}</b></div>", escape(name));
    }

    /// A drawing with its caption.
    pub(super) fn figure(&mut self, caption: &str, svg: &str) {
        let _ = writeln!(self.0, "<figure><figcaption>{}</figcaption>{svg}</figure>", escape(caption));
    }

    /// A list of other pages: what they are, and their paths from this one.
    pub(super) fn links(&mut self, links: &[(String, String)]) {
        if links.is_empty() {
            return;
        }
        self.raw("<ul>");
        for (what, path) in links {
            self.raw(&format!("<li><a href=\"{}\">{}</a></li>", escape(path), escape(what)));
        }
        self.raw("</ul>");
    }

    /// A row of a table of facts.
    pub(super) fn fact(&mut self, name: &str, value: &str) {
        let _ = writeln!(self.0, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(value));
    }
}

/// An angle in rad as HTML, degrees to three decimals; what rounds to zero has no sign.
pub(super) fn degrees(rad: f64) -> String {
    format!("{:.3}&deg;", (rad.to_degrees() * 1e3).round() / 1e3 + 0.0)
}

/// `text` for HTML.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// `text` for HTML; what stands between backticks is a command or a key.
pub(super) fn prose(text: &str) -> String {
    let pieces: Vec<String> = text.split('`').map(escape).collect();
    let whole = pieces.len() % 2 == 1;
    let mut html = String::new();
    for (i, piece) in pieces.iter().enumerate() {
        match (i, whole) {
            (0, _) => html.push_str(piece),
            (i, true) => {
                html.push_str(if i % 2 == 1 { "<code>" } else { "</code>" });
                html.push_str(piece);
            }
            // Unpaired ones stay as they are.
            (_, false) => {
                html.push('`');
                html.push_str(piece);
            }
        }
    }
    html
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backticks_become_code_where_they_are_paired() {
        assert_eq!(prose("run `freerig clear`."), "run <code>freerig clear</code>.");
        assert_eq!(prose("5` < 6"), "5` &lt; 6");
    }

    #[test]
    fn an_angle_that_rounds_to_zero_has_no_sign() {
        assert_eq!([degrees(-1e-9), degrees(-0.0), degrees(0.1)], ["0.000&deg;", "0.000&deg;", "5.730&deg;"]);
    }

    #[test]
    fn text_cannot_break_out_of_the_page() {
        assert_eq!(escape("<script> & \"x\""), "&lt;script&gt; &amp; &quot;x&quot;");
    }
}
