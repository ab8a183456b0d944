//! The live view's page: rerun's web viewer without its links to the outside.
//!
//! The stock page loads fonts from a third party and the stock server reports usage; here the files come from
//! this program, the links are cut, and a Content-Security-Policy lets the page talk to nothing but the live
//! data on loopback.

use std::io;
use std::net::TcpListener;
use std::sync::OnceLock;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{RawQuery, Request};
use axum::http::{HeaderValue, Response, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Redirect};
use axum::routing::get;
use re_web_viewer_server::WebViewerData;

/// Serves the page on `listener`, for the data on `data_port`, for ever.
pub(super) async fn serve(listener: TcpListener, data_port: u16) -> io::Result<()> {
    let files = files()?;
    let page = Bytes::from(without_links_to_the_outside(files.index_html()));
    let fixed = |bytes: &'static [u8], kind: &'static str| {
        get(move || async move { ([(header::CONTENT_TYPE, kind)], Bytes::from_static(bytes)) })
    };
    let start = start_url(data_port);
    let index = get(move |RawQuery(query): RawQuery| {
        let (page, start) = (page.clone(), start.clone());
        async move {
            match query {
                Some(q) if q.contains("url=") => {
                    ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], page).into_response()
                }
                _ => Redirect::temporary(&start).into_response(),
            }
        }
    });
    let policy = HeaderValue::from_str(&policy(data_port)).map_err(io::Error::other)?;
    let app = Router::new()
        .route("/", index)
        .route("/re_viewer.js", fixed(files.viewer_js(), "text/javascript"))
        .route("/re_viewer_bg.wasm", fixed(files.viewer_wasm(), "application/wasm"))
        .route("/favicon.ico", fixed(files.favicon(), "image/x-icon"))
        .route("/apple-touch-icon.png", fixed(files.apple_touch_icon(), "image/png"))
        .layer(middleware::from_fn(move |request: Request, next: Next| guard(policy.clone(), request, next)));
    axum::serve(tokio::net::TcpListener::from_std(listener)?, app).await
}

/// The viewer's files, which this program carries.
fn files() -> io::Result<&'static WebViewerData> {
    static FILES: OnceLock<WebViewerData> = OnceLock::new();
    if let Some(files) = FILES.get() {
        return Ok(files);
    }
    let files = WebViewerData::load(None).map_err(io::Error::other)?;
    Ok(FILES.get_or_init(|| files))
}

/// The page with the live data on `data_port` in it.
fn start_url(data_port: u16) -> String {
    format!("/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{data_port}%2Fproxy&hide_welcome_screen&renderer=webgl")
}

fn policy(data_port: u16) -> String {
    format!(
        "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
         img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; \
         connect-src 'self' http://127.0.0.1:{data_port} http://localhost:{data_port}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// Answers only who asks for this machine by a loopback name (a page from elsewhere whose name has been pointed
/// at 127.0.0.1 does not), and attaches the policy.
async fn guard(policy: HeaderValue, request: Request, next: Next) -> Response<Body> {
    let host = request.headers().get(header::HOST).and_then(|h| h.to_str().ok()).unwrap_or_default();
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    if !matches!(name, "127.0.0.1" | "localhost") {
        return StatusCode::FORBIDDEN.into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    response
}

/// The page without its `<link>` elements that point outside.
fn without_links_to_the_outside(html: &[u8]) -> String {
    let html = String::from_utf8_lossy(html);
    let mut page = String::with_capacity(html.len());
    let mut rest = html.as_ref();
    while let Some(begin) = rest.find("<link") {
        let end = rest[begin..].find('>').map_or(rest.len(), |i| begin + i + 1);
        page.push_str(&rest[..begin]);
        if !rest[begin..end].contains("://") {
            page.push_str(&rest[begin..end]);
        }
        rest = &rest[end..];
    }
    page.push_str(rest);
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_loads_nothing_from_outside() {
        let stock = files().unwrap().index_html();
        assert!(
            String::from_utf8_lossy(stock).contains("fonts.googleapis.com"),
            "the stock page has changed: read it again"
        );
        let page = without_links_to_the_outside(stock);
        assert!(!page.contains("fonts.g"));
        assert!(page.contains("favicon.ico") && page.contains("re_viewer.js") && page.contains("</html>"));
        for attribute in ["src=\"http", "href=\"http", "src=\"//", "href=\"//", "@import"] {
            assert!(!page.contains(attribute), "{attribute}");
        }
    }

    #[test]
    fn the_policy_lets_the_page_talk_to_the_data_port_only() {
        let policy = policy(1234);
        let connect = policy.split(';').find(|p| p.trim().starts_with("connect-src")).unwrap();
        assert_eq!(connect.trim(), "connect-src 'self' http://127.0.0.1:1234 http://localhost:1234");
        assert!(policy.starts_with("default-src 'none'"));
    }
}
