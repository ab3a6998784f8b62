//! Rust files as what they mean, for `layering`: every path that leads into the own crate, wherever it stands, and every
//! identifier. Parsed; comments and texts are none of it.

use crate::tree;
use proc_macro2::{Delimiter, Span, TokenStream, TokenTree};
use syn::visit::{self, Visit};

/// A path into the own crate, from its root: `pose`, `Problem` of `crate::pose::Problem`.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Import {
    /// Where it stands.
    pub(crate) line: usize,
    /// Names from the root on; empty for the root itself.
    pub(crate) path: Vec<String>,
    /// The path as it is written.
    pub(crate) text: String,
}

/// The module that a file of a crate is, from the file's path below `src`.
pub(crate) fn module_of(path: &str) -> Vec<String> {
    let path = path.trim_end_matches(".rs");
    let path = path.strip_suffix("/mod").unwrap_or(path);
    path.split('/')
        .filter(|name| !matches!(*name, "lib" | "main"))
        .map(str::to_owned)
        .collect()
}

/// All imports of a file, whose module is given: uses, paths in code, types, patterns and attributes, and in the arguments
/// and rules of macros.
///
/// # Panics
/// When it is no Rust.
pub(crate) fn imports(text: &str, module: &[String]) -> Vec<Import> {
    let file = syn::parse_file(text).expect("the compiler takes it");
    let mut found = Finder {
        module: module.to_vec(),
        imports: Vec::new(),
    };
    found.visit_file(&file);
    found.imports
}

/// Every identifier of a file of the checkout, with its line.
pub(crate) fn identifiers(path: &str) -> Vec<(usize, String)> {
    fn gather(tokens: TokenStream, found: &mut Vec<(usize, String)>) {
        for token in tokens {
            match token {
                TokenTree::Group(group) => gather(group.stream(), found),
                TokenTree::Ident(ident) => {
                    found.push((ident.span().start().line, ident.to_string()));
                }
                _ => {}
            }
        }
    }
    let tokens: TokenStream = tree::read(path).parse().expect("the compiler takes it");
    let mut found = Vec::new();
    gather(tokens, &mut found);
    found
}

/// Names of the types that a file defines, outside its tests.
///
/// # Panics
/// When it is no Rust.
pub(crate) fn types(text: &str) -> Vec<String> {
    struct Types(Vec<String>);
    impl<'ast> Visit<'ast> for Types {
        fn visit_item(&mut self, item: &'ast syn::Item) {
            let name = match item {
                syn::Item::Enum(item) => Some(&item.ident),
                syn::Item::Struct(item) => Some(&item.ident),
                syn::Item::Trait(item) => Some(&item.ident),
                syn::Item::Type(item) => Some(&item.ident),
                syn::Item::Union(item) => Some(&item.ident),
                _ => None,
            };
            self.0.extend(name.map(ToString::to_string));
            visit::visit_item(self, item);
        }

        fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
            let is_test = |a: &syn::Attribute| matches!(&a.meta, syn::Meta::List(list) if list.path.is_ident("cfg") && list.tokens.to_string() == "test");
            if !item.attrs.iter().any(is_test) {
                visit::visit_item_mod(self, item);
            }
        }
    }
    let file = syn::parse_file(text).expect("the compiler takes it");
    let mut found = Types(Vec::new());
    found.visit_file(&file);
    found.0
}

struct Finder {
    module: Vec<String>,
    imports: Vec<Import>,
}

impl Finder {
    /// Notes a path if it begins in the own crate.
    fn note(&mut self, segments: &[String], span: Span) {
        let mut at = match segments.first().map(String::as_str) {
            Some("crate") => Vec::new(),
            Some("self" | "super") => self.module.clone(),
            _ => return,
        };
        for segment in segments {
            match segment.as_str() {
                "crate" | "self" => {}
                "super" => drop(at.pop()),
                name => at.push(name.to_owned()),
            }
        }
        self.imports.push(Import {
            line: span.start().line,
            path: at,
            text: segments.join("::"),
        });
    }

    fn use_tree(&mut self, before: &[String], tree: &syn::UseTree) {
        let with = |ident: &syn::Ident| [before, &[ident.to_string()]].concat();
        match tree {
            syn::UseTree::Path(path) => self.use_tree(&with(&path.ident), &path.tree),
            syn::UseTree::Name(name) => self.note(&with(&name.ident), name.ident.span()),
            syn::UseTree::Rename(name) => self.note(&with(&name.ident), name.ident.span()),
            // Everything of a module is that module.
            syn::UseTree::Glob(glob) => self.note(before, glob.star_token.spans[0]),
            syn::UseTree::Group(group) => {
                for tree in &group.items {
                    self.use_tree(before, tree);
                }
            }
        }
    }

    /// Paths among tokens that are not parsed. `before` are the segments that a group continues.
    fn tokens(&mut self, before: &[String], tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let is_colon =
            |i: usize| matches!(tokens.get(i), Some(TokenTree::Punct(p)) if p.as_char() == ':');
        let mut i = 0;
        // In a group every part goes on where the path before it ended.
        let mut is_start = !before.is_empty();
        while let Some(token) = tokens.get(i) {
            i += 1;
            match token {
                TokenTree::Group(group) => self.tokens(&[], group.stream()),
                TokenTree::Punct(p) if p.as_char() == ',' => is_start = !before.is_empty(),
                TokenTree::Ident(first) if is_start || is_root(first) => {
                    let mut path = if is_start {
                        before.to_vec()
                    } else {
                        Vec::new()
                    };
                    is_start = false;
                    path.push(first.to_string());
                    while is_colon(i) && is_colon(i + 1) {
                        match tokens.get(i + 2) {
                            Some(TokenTree::Ident(next)) => path.push(next.to_string()),
                            Some(TokenTree::Group(group))
                                if group.delimiter() == Delimiter::Brace =>
                            {
                                self.tokens(&path, group.stream());
                            }
                            _ => {}
                        }
                        i += 3;
                    }
                    // `self` alone is a value, `crate` alone stands in a visibility.
                    if path.len() > 1 {
                        self.note(&path, first.span());
                    }
                }
                _ => {}
            }
        }
    }
}

fn is_root(ident: &proc_macro2::Ident) -> bool {
    ident == "crate" || ident == "super" || ident == "self"
}

impl<'ast> Visit<'ast> for Finder {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if item.attrs.iter().any(|a| a.path().is_ident("path")) {
            // Where the code of such a module lies is not where its imports would be looked for.
            self.note(&["crate".to_owned()], item.ident.span());
        }
        self.module.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.module.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.use_tree(&[], &item.tree);
    }

    fn visit_item_extern_crate(&mut self, item: &'ast syn::ItemExternCrate) {
        if item.ident == "self" {
            self.note(&["crate".to_owned()], item.ident.span());
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Vec<String> = path.segments.iter().map(|s| s.ident.to_string()).collect();
        // `self` alone is a value.
        if let ([_, _, ..], Some(first)) = (segments.as_slice(), path.segments.first()) {
            self.note(&segments, first.ident.span());
        }
        visit::visit_path(self, path);
    }

    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_macro(&mut self, mac: &'ast syn::Macro) {
        if mac.path.is_ident("include") {
            let span = mac.path.segments[0].ident.span();
            self.note(&["crate".to_owned()], span);
        }
        self.visit_path(&mac.path);
        self.tokens(&[], mac.tokens.clone());
    }

    fn visit_attribute(&mut self, attribute: &'ast syn::Attribute) {
        if attribute.path().is_ident("doc") {
            return;
        }
        if let syn::Meta::List(list) = &attribute.meta {
            self.tokens(&[], list.tokens.clone());
            // Serde takes paths as texts.
            for token in list.tokens.clone() {
                if let TokenTree::Literal(literal) = token
                    && let Ok(text) = syn::parse_str::<syn::LitStr>(&literal.to_string())
                    && let Ok(path) = text.parse::<syn::Path>()
                {
                    let names: Vec<_> = path.segments.iter().map(|s| s.ident.to_string()).collect();
                    if names.len() > 1 {
                        self.note(&names, literal.span());
                    }
                }
            }
        }
    }
}

#[test]
fn every_way_to_name_a_module_is_found() {
    let module = module_of("relocalizer/steps.rs");
    let paths = |text: &str| -> Vec<String> {
        let found = imports(text, &module);
        found.iter().map(|import| import.path.join("::")).collect()
    };
    for (text, expected) in [
        (
            "use crate::image::{GrayView, check};",
            &["image::GrayView", "image::check"][..],
        ),
        (
            "use crate::{image::{A, B}, pose as p, math::*};",
            &["image::A", "image::B", "pose", "math"],
        ),
        ("use super::super::pose::X;", &["pose::X"]),
        ("use super::tracking::X;", &["relocalizer::tracking::X"]),
        ("use crate as root;", &[""]),
        ("use super::super as root;", &[""]),
        ("use crate::*;", &[""]),
        ("extern crate self as root;", &[""]),
        ("#[path = \"../pose/mod.rs\"] mod p;", &[""]),
        ("include!(\"../pose/x.rs\");", &[""]),
        (
            "fn f() -> crate::pose::X { crate::lsd::y(super::super::nn::Z) }",
            &["pose::X", "lsd::y", "nn::Z"],
        ),
        (
            "fn f<T: crate::pose::X>(t: impl crate::lsd::Y) {}",
            &["pose::X", "lsd::Y"],
        ),
        (
            "fn f(x: T) { if let crate::pose::X(_) = x {} }",
            &["pose::X"],
        ),
        (
            "mod inner { use super::super::super::pose::X; }",
            &["pose::X"],
        ),
        (
            "mod inner { mod deep { fn f() { super::super::g() } } }",
            &["relocalizer::steps::g"],
        ),
        (
            "fn f() { assert_eq!(crate::pose::x(), 1, \"crate::lsd::z\"); }",
            &["pose::x"],
        ),
        ("fn f() { vec![super::super::pose::x()]; }", &["pose::x"]),
        (
            "macro_rules! m { () => { $crate::pose::x() } }",
            &["pose::x"],
        ),
        (
            "m! { use crate::{pose::{X, Y}, lsd}; }",
            &["pose", "pose::X", "pose::Y", "lsd"],
        ),
        ("#[derive(crate::pose::D)] struct S;", &["pose::D"]),
        (
            "#[serde(with = \"crate::pose::with\")] struct S;",
            &["pose::with"],
        ),
        (
            "impl crate::pose::T for S { type X = crate::lsd::Y; }",
            &["pose::T", "lsd::Y"],
        ),
        // None of these is an import.
        ("pub(crate) use other_crate::pose;", &[]),
        (
            "pub(in crate::relocalizer) fn f(self: &Self) { self.pose() }",
            &[],
        ),
        (
            "/// crate::pose::X\nfn f() { let s = \"crate::pose\"; } // crate::lsd",
            &[],
        ),
        ("use std::pose::X; fn f() { landline::pose::x() }", &[]),
    ] {
        let mut found = paths(text);
        found.sort();
        let mut expected = expected.to_vec();
        expected.sort_unstable();
        assert_eq!(found, expected, "{text}");
    }
}

#[test]
fn modules_of_files() {
    for (file, module) in [
        ("lib.rs", &[][..]),
        ("units.rs", &["units"]),
        ("pose/mod.rs", &["pose"]),
        ("pose/solvers/p3p.rs", &["pose", "solvers", "p3p"]),
    ] {
        assert_eq!(module_of(file), module, "{file}");
    }
}
