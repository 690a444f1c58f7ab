//! `#[derive(Wire)]`: the table of fields of a wire type, made from its declaration.
//!
//! The result is an implementation of `protocol::wire::Wire` and a compile-time proof that the
//! fields fill the struct without gaps. Attributes of a field, all optional:
//!
//! | attribute | meaning |
//! |---|---|
//! | `tag = N` | protobuf field number in recordings, never reused; without it not recorded |
//! | `hash` | a hash: `fixed64` in recordings, hexadecimal in tables |
//! | `count = FIELD` | the first elements of this array are in use; FIELD counts them |
//! | `payload = "NAME"` | bytes of the payload behind the block; the payload is recorded as NAME |
//! | `elements = TYPE` | a section of the payload with elements of this type |
//! | `name = "NAME"` | its name in recordings and tables, where it is another |
//! | `columns = "A,B"` | names of its columns in tables; empty: no column |
//!
//! `#[wire(name = "NAME")]` on the struct gives its message in recordings another name.

use proc_macro2::TokenStream;
use quote::quote;
use syn::{
    Attribute, Data, DeriveInput, Error, Field, Fields, Ident, LitInt, LitStr, Type, parse_macro_input,
};

/// Implements `protocol::wire::Wire` for a `#[repr(C)]` struct with named fields.
#[proc_macro_derive(Wire, attributes(wire))]
pub fn derive_wire(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    expand(&input).unwrap_or_else(|e| e.into_compile_error()).into()
}

fn expand(input: &DeriveInput) -> Result<TokenStream, Error> {
    let Data::Struct(data) = &input.data else {
        return Err(Error::new_spanned(&input.ident, "a wire type is a struct"));
    };
    let Fields::Named(fields) = &data.fields else {
        return Err(Error::new_spanned(&input.ident, "the fields of a wire type have names"));
    };
    if !input.generics.params.is_empty() {
        return Err(Error::new_spanned(&input.generics, "a wire type has no parameters"));
    }
    if !is_repr_c(&input.attrs)? {
        return Err(Error::new_spanned(&input.ident, "a wire type is #[repr(C)]"));
    }
    let ident = &input.ident;
    let name = message_name(input)?;
    let rows = fields.named.iter().map(|f| row(ident, f)).collect::<Result<Vec<_>, _>>()?;
    Ok(quote! {
        impl ::protocol::wire::Wire for #ident {
            const KIND: ::protocol::wire::Kind = ::protocol::wire::Kind::Struct(&::protocol::wire::Layout {
                name: #name,
                size: ::core::mem::size_of::<#ident>(),
                fields: &[#(#rows),*],
            });
        }
        const _: () = ::protocol::wire::layout_of::<#ident>().prove();
    })
}

/// The row of a field in the table.
fn row(owner: &Ident, field: &Field) -> Result<TokenStream, Error> {
    let ident = field.ident.as_ref().expect("fields have names");
    let ty = &field.ty;
    let Options { tag, role, name, columns } = options(owner, field)?;
    let name = name.unwrap_or_else(|| ident.to_string());
    let columns = columns
        .map_or_else(|| quote!(::core::option::Option::None), |c| quote!(::core::option::Option::Some(#c)));
    Ok(quote! {
        ::protocol::wire::Field {
            name: #name,
            offset: ::core::mem::offset_of!(#owner, #ident),
            kind: <#ty as ::protocol::wire::Wire>::KIND,
            tag: #tag,
            role: #role,
            columns: #columns,
        }
    })
}

/// Attributes of a field.
struct Options {
    tag: u32,
    role: TokenStream,
    name: Option<String>,
    columns: Option<String>,
}

fn options(owner: &Ident, field: &Field) -> Result<Options, Error> {
    let (mut tag, mut name, mut columns) = (0, None, None);
    let mut role = quote!(::protocol::wire::Role::Value);
    for attribute in field.attrs.iter().filter(|a| a.path().is_ident("wire")) {
        attribute.parse_nested_meta(|meta| {
            if meta.path.is_ident("tag") {
                tag = meta.value()?.parse::<LitInt>()?.base10_parse()?;
            } else if meta.path.is_ident("hash") {
                role = quote!(::protocol::wire::Role::Hash);
            } else if meta.path.is_ident("count") {
                let count: Ident = meta.value()?.parse()?;
                role = quote!(::protocol::wire::Role::Counted(::core::mem::offset_of!(#owner, #count)));
            } else if meta.path.is_ident("payload") {
                let name: LitStr = meta.value()?.parse()?;
                role = quote!(::protocol::wire::Role::Payload(#name));
            } else if meta.path.is_ident("elements") {
                let element: Type = meta.value()?.parse()?;
                role = quote!(::protocol::wire::Role::Section(<#element as ::protocol::wire::Wire>::KIND));
            } else if meta.path.is_ident("name") {
                name = Some(meta.value()?.parse::<LitStr>()?.value());
            } else if meta.path.is_ident("columns") {
                columns = Some(meta.value()?.parse::<LitStr>()?.value());
            } else {
                return Err(meta.error("expected tag, hash, count, payload, elements, name or columns"));
            }
            Ok(())
        })?;
    }
    Ok(Options { tag, role, name, columns })
}

fn message_name(input: &DeriveInput) -> Result<String, Error> {
    let mut name = input.ident.to_string();
    for attribute in input.attrs.iter().filter(|a| a.path().is_ident("wire")) {
        attribute.parse_nested_meta(|meta| {
            if !meta.path.is_ident("name") {
                return Err(meta.error("expected name"));
            }
            name = meta.value()?.parse::<LitStr>()?.value();
            Ok(())
        })?;
    }
    Ok(name)
}

fn is_repr_c(attributes: &[Attribute]) -> Result<bool, Error> {
    let mut found = false;
    for attribute in attributes.iter().filter(|a| a.path().is_ident("repr")) {
        attribute.parse_nested_meta(|meta| {
            found |= meta.path.is_ident("C");
            Ok(())
        })?;
    }
    Ok(found)
}
