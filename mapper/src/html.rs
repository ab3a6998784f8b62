//! What pages of reports share: style, heading, text and numbers.

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#1c2024;background:#fff;max-width:1180px;margin:32px auto;padding:0 20px}\
h1{font-size:24px;margin:0 0 4px}h2{font-size:18px;margin:32px 0 8px}p{margin:6px 0}.quiet{color:#60666c}\
table{border-collapse:collapse;display:block;overflow-x:auto;max-width:100%;margin:8px 0;font-variant-numeric:tabular-nums}\
th,td{padding:5px 12px;text-align:right;border-bottom:1px solid #e4e7ea}th{font-weight:600;color:#3a4046}\
th:first-child,td:first-child{text-align:left;padding-left:0}tr.main td{font-weight:600}\
.plots{display:flex;flex-wrap:wrap;gap:12px}.plots svg{max-width:100%;height:auto}\
.bar{display:inline-block;height:10px;background:#0072b2;border-radius:2px;vertical-align:middle}\
figure{margin:0 0 20px}figure img{max-width:100%;border-radius:4px}figcaption{color:#60666c;font-size:13px}\
.fails{display:grid;grid-template-columns:repeat(auto-fill,minmax(340px,1fr));gap:16px}";

/// The beginning of a page with its heading, which is HTML already; `</html>` ends it.
pub(crate) fn head(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n<h1>{title}</h1>\n"
    )
}

/// Text as HTML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A number, or a dash where there is none.
pub(crate) fn number(value: f64, digits: usize) -> String {
    if value.is_finite() {
        format!("{value:.digits$}")
    } else {
        "&ndash;".to_owned()
    }
}
